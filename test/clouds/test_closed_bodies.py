"""Volumes of bodies: corrections, what depends on the closing, and uncertainty against independent
computation and repeated clouds.
"""

import dataclasses

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, sphere, torus

from benchmarks.truth import box_faces, sample_polygons
from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.body_volume import body_of, cloud_uncertainty, mesh_uncertainty
from ladar_volume.clouds.cloud_bodies import cloud_bodies, remove_stray_parts
from ladar_volume.clouds.filter.filter_adjoint import influence
from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.clouds.ground_readings import plane_covariance, with_base_surface
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.mesh.local_mesh import LocalMesh
from ladar_volume.mesh.tetrahedra import closed_variance
from ladar_volume.mesh.topology import orient
from ladar_volume.model.body_parameters import BodyParameters
from ladar_volume.model.errors import FilterError, SurfaceError, VolumeError
from ladar_volume.model.parameters import FilterParameters, GroundParameters
from ladar_volume.model.records import Plane
from ladar_volume.simulation.scenes import Ground
from ladar_volume.uncertainty.ground_field import Roughness

RADIUS = 0.3
PLANE = GroundParameters(degree=1)


def ball_on_ground(rng, count=2500, noise=0.01):
    """A ball that is cut by its ground at a third of its radius, and the ground around it, with
    noise along the normals.
    """
    n = rng.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n = n[n[:, 2] > -0.3]
    xy = rng.uniform(-1, 1, (count, 2))
    flat = np.column_stack([xy, np.full(count, -0.3 * RADIUS)])[np.hypot(*xy.T) > 0.95 * RADIUS]
    ball = RADIUS * n + noise * rng.uniform(-1.7, 1.7, (len(n), 1)) * n
    flat[:, 2] += noise * rng.uniform(-1.7, 1.7, len(flat))
    return np.concatenate([ball, flat])


def cube_cloud(rng, per_face=400, noise=0.01):
    """All six faces of a unit cube."""
    parts = []
    for axis in range(3):
        for side in (-0.5, 0.5):
            p = np.insert(rng.uniform(-0.5, 0.5, (per_face, 2)), axis, side, axis=1)
            p[:, axis] += noise * rng.uniform(-1.7, 1.7, per_face)
            parts.append(p)
    return np.concatenate(parts)


def measured(points, stands=False):
    f = filter_cloud(points, FilterParameters(), auto=True)
    ground = None
    label = np.zeros(len(f.r), np.int64)
    if stands:
        ground = fit_ground(f.r, f.sigma**2, GroundParameters())
        label = np.where(
            (f.r[:, 2] > -0.3 * RADIUS + 0.02) & (np.linalg.norm(f.r, axis=1) < 1.2 * RADIUS), 0, -1
        )
    made = cloud_bodies(f.r, f.normal, f.curved, label, ground)
    return made, cloud_uncertainty(made.bodies, made.sources, points, f, ground), f


def test_a_cloud_of_a_cube_gives_its_volume_with_a_sigma():
    error, sigma = [], []
    for seed in range(4):
        made, uncertain, _ = measured(cube_cloud(np.random.default_rng(seed)))
        body = made.bodies[0]
        error.append(body.volume_m3 - 1.0)
        sigma.append(float(uncertain.sigma_m3[0]))
        assert (
            body.uncorrected_m3 < body.volume_m3
            and body.edge_m3 > 0.002
            and abs(body.curvature_m3) < 1e-4
        )
        assert orient(body.skin.vertices, body.skin.triangles).euler == 2
        assert np.allclose(body.centroid_map, 0.0, atol=0.01)
        assert sum(uncertain.budget_m6[0].values()) == pytest.approx(float(uncertain.C_m6[0, 0]))
    # the noise of 6 faces of 400 points each
    assert np.mean(sigma) == pytest.approx(np.sqrt(6) * 0.01 / 20, rel=0.35)
    assert np.abs(error).max() < 4 * np.mean(sigma)


def test_a_ball_on_its_ground_is_closed_and_its_sigma_knows_the_ground():
    made, uncertain, f = measured(ball_on_ground(np.random.default_rng(5)), stands=True)
    body = made.bodies[0]
    cap = np.pi * (0.7 * RADIUS) ** 2 * (3 * RADIUS - 0.7 * RADIUS) / 3
    truth = 4 / 3 * np.pi * RADIUS**3 - cap
    assert body.volume_m3 == pytest.approx(truth, rel=0.02)
    assert body.closed_m3 > 0.0 and [c.name for c in body.closures] == ["ground"]
    budget = uncertain.budget_m6[0]
    assert 0.0 < budget["ground"] < budget["noise"] and budget["closing"] > 0.0
    # without the points' own correlations it would be far too small
    w = np.einsum("ni,ni->n", body.gradient, f.normal[made.sources[0]])
    naive = float(np.sqrt(w**2 @ f.sigma[made.sources[0]] ** 2))
    assert uncertain.sigma_m3[0] > 2.0 * naive


def test_the_influence_of_raw_points_is_that_of_repeated_clouds():
    """The mean height of a noisy plane: every raw point has its share, and the spread over clouds
    is what the shares say.
    """
    heights, predicted = [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        p = np.column_stack([rng.uniform(0, 1, (500, 2)), 0.005 * rng.normal(size=500)])
        f = filter_cloud(p, FilterParameters(), auto=True)
        s = influence(p, f, f.normal[:, 2:] / len(f.r))[:, 0] * f.normal[:, 2]
        assert s.sum() == pytest.approx(1.0, rel=1e-3), "a common shift is a common shift"
        heights.append(float(f.r[:, 2].mean()))
        predicted.append(float(np.sqrt(s**2 @ f.noise**2)))
    assert np.mean(predicted) == pytest.approx(0.005 / np.sqrt(500), rel=0.15)
    assert np.sqrt(np.mean(np.square(heights))) == pytest.approx(np.mean(predicted), rel=0.35)


@pytest.mark.parametrize("thick_m", [0.05, 0.3])
def test_two_faces_in_one_neighbourhood_do_not_share_their_noise(thick_m):
    """A plate: whatever the signs of the normals, its thickness has the noise of both faces."""
    rng, each = np.random.default_rng(11), 400
    xy = rng.uniform(0, 1, (2 * each, 2))
    p = np.column_stack([xy, np.repeat([0.0, thick_m], each) + 0.005 * rng.normal(size=2 * each)])
    n = np.tile([0.0, 0.0, 1.0], (2 * each, 1)) * rng.choice([-1.0, 1.0], (2 * each, 1))
    on = np.column_stack([xy, np.repeat([p[:each, 2].mean(), p[each:, 2].mean()], each)])
    rows, noise = np.arange(2 * each), np.full(2 * each, 0.005)
    none = np.zeros(0, np.int64)
    f = CloudResult(on, rows, n, noise, none, none, {}, noise=noise, reach=np.full(len(on), 1.5))
    side = np.repeat([-1.0, 1.0], each)[:, None] / each
    s = influence(p, f, n[:, 2:] * side)
    assert np.sqrt((s**2).sum()) == pytest.approx(np.sqrt(2.0 / each), rel=0.02)
    level = influence(p, f, n[:, 2:] * abs(side))
    assert np.sqrt((level**2).sum()) == pytest.approx(np.sqrt(2.0 / each), rel=0.02)


def test_influence_counts_along_normals_of_either_sign():
    rng = np.random.default_rng(7)
    p = np.column_stack([rng.uniform(0, 1, (300, 2)), 0.005 * rng.normal(size=300)])
    f = filter_cloud(p, FilterParameters(), auto=True)
    sign = rng.choice([-1.0, 1.0], len(f.r))
    other = CloudResult(
        f.r,
        f.index,
        f.normal * sign[:, None],
        f.sigma,
        f.outliers,
        f.reason,
        f.report,
        noise=f.noise,
        reach=f.reach,
    )
    w = rng.uniform(size=(len(f.r), 2))
    assert np.allclose(
        influence(p, other, w * sign[:, None]), influence(p, f, w) * sign[:, None], atol=1e-12
    )
    bare = CloudResult(f.r, f.index, f.normal, f.sigma, f.outliers, f.reason, f.report)
    with pytest.raises(FilterError) as error:
        influence(p, bare, w)
    assert error.value.reason == "filter_influence"


def test_a_mesh_with_independent_vertices_has_the_variance_of_its_tetrahedra():
    v, t = sphere(400)
    body = body_of(v, t)
    plain = closed_variance(v, body.closed, 0.01)
    found = mesh_uncertainty([body], 0.01)
    assert (
        found.sigma_m3[0] == pytest.approx(plain.sigma_m3) and body.volume_m3 == body.uncorrected_m3
    )


def test_sigma_of_an_open_mesh_on_an_uncertain_ground_matches_repetition():
    v, t = sphere(300)
    t = t[v[t].max(axis=1)[:, 2] > -0.5]
    C = np.diag([0.01, 0.005, 0.005]) ** 2
    ground = Plane(np.zeros(2), np.array([-0.55, 0.0, 0.0]), C, np.zeros(0, np.int64))
    body = body_of(v, t, close_m=0.4, ground=ground)
    found = mesh_uncertainty([body], 0.004, ground)
    assert found.budget_m6[0]["ground"] == pytest.approx(body.by_ground @ C @ body.by_ground)
    rng = np.random.default_rng(8)
    volumes = []
    for _ in range(150):
        plane = design_surface(rng.multivariate_normal(ground.beta, C))
        volumes.append(
            body_of(
                v + 0.004 * rng.normal(size=v.shape),
                t,
                close_m=0.5,
                ground=plane,
                allow_crossings=True,
            ).volume_m3
        )
    predicted = np.sqrt(found.C_m6[0, 0] - found.budget_m6[0]["closing"])
    assert np.std(volumes) == pytest.approx(predicted, rel=0.2)


def test_cavities_count_negative_and_lose_their_bulge():
    v, t = sphere(2000)
    both = np.concatenate([v, 0.5 * v])
    body = body_of(both, np.concatenate([t, t + len(v)]), np.concatenate([v, v]))
    assert body.volume_m3 == pytest.approx(4 / 3 * np.pi * (1 - 0.125), rel=3e-5)
    assert body.curvature_m3 > 0.0 and np.allclose(body.centroid_map, 0.0, atol=1e-3)


def test_the_centre_of_a_body_does_not_depend_on_where_it_is():
    v, t = torus()
    far = np.array([4e5, 5e6, 300.0])
    assert np.allclose(
        body_of(v + far, t).centroid_map - far, body_of(v, t).centroid_map, atol=1e-6
    )


def test_bodies_have_a_joint_covariance():
    rng = np.random.default_rng(9)
    one = cube_cloud(rng)
    points = np.concatenate([one, cube_cloud(rng) + np.array([2.0, 0, 0])])
    f = filter_cloud(points, FilterParameters(), auto=True)
    made = cloud_bodies(f.r, f.normal, f.curved, (f.r[:, 0] > 1.0).astype(np.int64), None)
    C = cloud_uncertainty(made.bodies, made.sources, points, f, None).C_m6
    assert len(made.bodies) == 2 and abs(C[0, 1]) < 1e-3 * C[0, 0]
    # one body cut out twice is one body: fully correlated
    twice = cloud_uncertainty([made.bodies[0]] * 2, [made.sources[0]] * 2, points, f, None).C_m6
    assert twice[0, 1] == pytest.approx(twice[0, 0])


def test_stray_pieces_are_left_out_and_reported():
    rng = np.random.default_rng(10)
    flake = np.array([[3.0, 0, 0], [3.05, 0, 0], [3.0, 0.05, 0], [3.05, 0.05, 0.0]])
    v = sphere(1500, rng=rng)[0]
    made = cloud_bodies(
        np.concatenate([v, flake]),
        np.concatenate([v, np.tile([0, 0, 1.0], (4, 1))]),
        None,
        np.zeros(1504, np.int64),
        None,
    )
    assert made.stray[0] == 2 and made.bodies[0].volume_m3 == pytest.approx(4 / 3 * np.pi, rel=1e-3)


def test_a_closed_speck_is_left_out_and_a_second_body_is_not():
    v, t = sphere(1500)
    speck, tetra = (
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
        np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    )
    for size, left in ((0.1, 4), (0.5, 0)):
        vertices = np.concatenate([v, 3.0 + size * speck])
        faces = np.concatenate([t, tetra + len(v)]).astype(np.int32)
        mesh = LocalMesh(
            vertices,
            np.zeros_like(vertices),
            faces,
            np.zeros(len(faces), np.int32),
            np.zeros(len(vertices), np.int32),
            (),
            np.zeros((0, 2), np.int32),
            {"hole_m": 0.2},
        )
        kept, many = remove_stray_parts(mesh)
        assert many == left and np.array_equal(kept, faces[: len(faces) - left])


def test_what_is_no_body_is_refused():
    with pytest.raises(VolumeError) as none:
        cloud_bodies(np.zeros((5, 3)), None, None, np.full(5, -1), None)
    assert none.value.reason == "volume_no_body"
    flat = np.random.default_rng(11).uniform(size=(400, 3)) * [1, 1, 0]
    label = np.repeat([0, 1], 200)
    steps = []
    with pytest.raises(SurfaceError, match="body 1: a gap") as gap:
        cloud_bodies(
            flat,
            np.tile([0, 0, 1.0], (400, 1)),
            None,
            label,
            None,
            BodyParameters(),
            lambda k, many: steps.append((k, many)),
        )
    # the second is tried though the first failed
    assert gap.value.reason == "closing_gap" and steps == [(0, 2), (1, 2)]
    corner = np.array([[0, 0, 1.0], [1, 0, 1], [0, 1, 1], [0, 0, 1]])
    for points, ground in (
        (corner, design_surface([0.0])),
        (corner[:3], None),
        (np.ones((50, 3)), None),
    ):
        with pytest.raises(SurfaceError) as few:
            cloud_bodies(points, None, None, np.zeros(len(points), np.int64), ground)
        assert few.value.reason == "mesh_points" and few.value.value < 4
    crossed = np.concatenate([CUBE_V, CUBE_V + 0.4])
    with pytest.raises(SurfaceError) as error:
        body_of(crossed, np.concatenate([CUBE_T, CUBE_T + 8]))
    assert error.value.reason == "mesh_self_intersecting"
    assert (
        body_of(crossed, np.concatenate([CUBE_T, CUBE_T + 8]), allow_crossings=True).crossing_pairs
        > 0
    )


def box_on_rough_ground(seed, rough_m=0.006):
    """Points of an exact box of 1.6 x 1.2 x 0.8 m and of the ground around it, their normals, the
    label of the box, and its volume above the true ground.
    """
    rng, size = np.random.default_rng([seed, 31]), np.array([1.6, 1.2, 0.8])
    ground = Ground(rough_m=rough_m, length_m=0.7, seed=seed)
    x, y = size[:2] / 2
    faces = box_faces(np.array([-x, -y, 0.05]), np.array([x, y, size[2]]))
    at, n = sample_polygons(faces[1:], 1500, rng)
    q = rng.uniform(-3.0, 3.0, (4000, 2))
    q = q[(np.abs(q) > (x + 0.05, y + 0.05)).any(axis=1)]
    r = np.concatenate([at, np.c_[q, ground(*q.T)]])
    normal = np.concatenate([n, np.tile([0.0, 0.0, 1.0], (len(q), 1))])
    label = np.where(np.arange(len(r)) < len(at), 0, -1)
    truth = 4 * x * y * (size[2] - ground.mean_over_box(-x, x, -y, y))
    return BodyPoints(r, normal, None, np.full(len(r), 1e-4)), label, truth


def test_rough_ground_under_a_body_is_in_sigma():
    z, share = [], []
    for seed in range(12):
        points, label, truth = box_on_rough_ground(seed)
        ground = fit_ground(points.r[label < 0], np.zeros(int((label < 0).sum())), PLANE)
        ground = dataclasses.replace(ground, support=ground.support + int((label == 0).sum()))
        made = cloud_bodies(points.r, points.normal, None, label, ground)
        known = with_base_surface(mesh_uncertainty(made.bodies, 1e-4), made, points)
        z.append((made.bodies[0].volume_m3 - truth) / known.sigma_m3[0])
        share.append(known.budget_m6[0]["base_surface"] / known.C_m6[0, 0])
        assert sum(known.budget_m6[0].values()) == pytest.approx(known.C_m6[0, 0])
    assert min(share) > 0.9  # nothing else moves these
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_a_level_that_the_ground_moves_alike_is_common_to_all_bodies():
    """The plane through rough ground moves all bodies; its covariance by the full matrix."""
    rng, rough = np.random.default_rng(5), Roughness(0.01**2, 0.6, 0.3, 1.0)
    xy = rng.uniform(-3.0, 3.0, (500, 2))
    plane = Plane(np.zeros(2), np.zeros(3), np.zeros((3, 3)), np.arange(500), 0.0)
    C = plane_covariance(np.c_[xy, np.zeros(500)], plane, rough)
    X = np.c_[np.ones(500), xy]
    full = rough.variance_m2 * rough.correlation(np.linalg.norm(xy[:, None] - xy, axis=2))
    H = np.linalg.pinv(X)
    scale = np.sqrt(np.diagonal(H @ full @ H.T))
    assert np.abs((C - H @ full @ H.T) / np.outer(scale, scale)).max() < 0.05

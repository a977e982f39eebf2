"""What sigma of a body holds beside the noise, and what its shape says against its volume."""

import dataclasses

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, sphere

from ladar_volume.clouds.body_checks import (
    FilterComparison,
    check_bodies,
    check_doubts,
    check_thin_walls,
    off_points,
    uncertainty,
)
from ladar_volume.clouds.body_points import (
    BodyPoints,
    excluded_points,
    filtered_points,
    good_points,
    halves,
    unfiltered_points,
)
from ladar_volume.clouds.body_volume import body_of
from ladar_volume.clouds.body_walls import (
    cut_off_m2,
    foot_doubts,
    shape_lines,
    share_of_ground_under,
    thin_share,
)
from ladar_volume.clouds.cloud_bodies import CloudBodies, cloud_bodies
from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.clouds.ground_cover import away_from
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.mesh.unseen_foot import between_tangent_and_circle
from ladar_volume.model.body_parameters import BodyParameters
from ladar_volume.model.errors import SurfaceError

BALL_M3 = 4.0 / 3.0 * np.pi


def answer(r, normal, noise):
    """A filter's answer that keeps every point, without edges or regions."""
    n = len(r)
    none = np.zeros(0, np.int64)
    return CloudResult(
        r,
        np.arange(n),
        normal,
        np.full(n, noise / 3.0),
        none,
        none,
        {"noise_m": noise},
        noise=np.full(n, noise),
        reach=np.full(n, 0.5),
        curved=np.ones(n, bool),
    )


@pytest.mark.parametrize("shift", [-0.01, 0.01])
def test_surfaces_off_their_points_are_put_right(shift):
    v, _ = sphere(1500)
    noise = 0.01 * np.random.default_rng(2).normal(size=(len(v), 1))
    of = filtered_points(answer((1.0 + shift) * v, v, 0.01))
    made = cloud_bodies(of.r, of.normal, of.curved, np.zeros(len(v), np.int64), None)
    lost = made.bodies[0].volume_m3 - BALL_M3
    assert abs(lost) == pytest.approx(0.03 * BALL_M3, rel=0.05)
    found, checked = check_bodies(made, of, v + noise * v, BodyParameters())
    told = uncertainty(found, checked, of, v + noise * v)
    sigma = float(told.sigma_m3[0])
    assert found.bodies[0].fit_m3 == pytest.approx(-lost, rel=0.1)
    assert abs(found.bodies[0].volume_m3 - BALL_M3) < 2.0 * sigma < 0.2 * abs(lost)
    assert told.budget_m6[0]["fit"] > 0.0
    assert sum(told.budget_m6[0].values()) == pytest.approx(float(told.C_m6[0, 0]))


def test_noise_alone_moves_no_volume():
    v, _ = sphere(1500)
    of = filtered_points(answer(v, v, 0.01))
    body = cloud_bodies(of.r, of.normal, of.curved, np.zeros(len(v), np.int64), None).bodies[0]
    moved = []
    for seed in range(40):
        noise = 0.01 * np.random.default_rng(seed).normal(size=(len(v), 1))
        moved.append(off_points(body, np.arange(len(v)), v + noise * v, of))
    fit = np.array([m for m, _ in moved])
    null = 0.01 * np.linalg.norm(body.gradient)
    # 5 % lie beyond two standard deviations, and are drawn in
    assert np.count_nonzero(fit) <= 6 and np.abs(fit).max() < 2.0 * null
    assert np.mean([v for _, v in moved]) < null**2


def test_halves_tell_what_the_chords_leave_out():
    for count, seed in ((300, 0), (1200, 1)):
        v = np.random.default_rng(seed).normal(size=(count, 3))
        v /= np.linalg.norm(v, axis=1)[:, None]
        of = BodyPoints(v, None, None, np.full(len(v), 1e-6))
        made = cloud_bodies(v, None, None, np.zeros(len(v), np.int64), None)
        found, checked = check_bodies(made, of, v, BodyParameters())
        error = found.bodies[0].volume_m3 - BALL_M3
        sigma = float(uncertainty(found, checked, of, v).sigma_m3[0])
        assert error < 0.0 and 0.7 < -error / sigma < 1.5
    many = np.random.default_rng(2).normal(size=(20_000, 3))
    assert len(halves(many)) == 4 and len(halves(many[:100])) == 6


def test_halves_that_make_no_body_are_doubted():
    # a ball of 30 points: of 15 hardly a ball is made
    v = np.random.default_rng(0).normal(size=(30, 3))
    v /= np.linalg.norm(v, axis=1)[:, None]
    made = cloud_bodies(v, None, None, np.zeros(len(v), np.int64), None)
    _, checked = check_bodies(made, BodyPoints(v, None, None, None), v, BodyParameters())
    assert checked[0].half_count == 6 and len(checked[0].between_m3) < 6
    (doubt,) = check_doubts(checked)
    assert doubt.name == "body_half" and "scan it more densely" in doubt.text


def test_good_points_that_a_filter_left_out():
    rng = np.random.default_rng(4)
    pile = np.column_stack([rng.uniform(-5, 5, (2000, 2)), np.zeros(2000)])
    pile[:, 2] = np.maximum(0.0, 2.0 - np.hypot(*pile[:, :2].T))
    other = pile[pile[:, 2] > 0.5] * (1, 1, 0.5) + (20, 0, 0)
    raw = np.concatenate([pile, other, rng.uniform((-5, -5, 3), (5, 5, 9), (20, 3))])
    kept = np.flatnonzero(np.arange(len(raw)) < len(pile))
    up = np.tile([0.0, 0, 1], (len(kept), 1))
    gone = np.arange(len(pile), len(raw))
    few = np.ones(len(gone), np.int64)
    result = CloudResult(
        raw[kept], kept, up, np.full(len(kept), 0.01), gone, few, {"noise_m": 0.01}
    )
    good = good_points(raw, result)
    assert good[: len(pile) + len(other)].all() and good[len(pile) + len(other) :].mean() < 0.3
    # one body of two is lost: its own share counts, not that of the whole
    lost = excluded_points(raw, good, result, design_surface([0.0]))
    assert lost.share == 1.0 and lost.above == pytest.approx(len(other), abs=3)
    # a few points by themselves are no body: the end of a wall that was seen aslant
    few_left = np.concatenate([pile, other[:12]])
    still = dataclasses.replace(result, outliers=np.arange(len(pile), len(few_left)))
    lost_few = excluded_points(few_left, np.ones(len(few_left), bool), still, design_surface([0.0]))
    assert 0.0 < lost_few.share < 0.05
    came = unfiltered_points(raw, good, 0.01, lost.share)
    assert came.filtered is None and np.array_equal(came.r, raw[good])


def lifted_ball(low, floor_under):
    """A ball of 1 m whose middle is 0.6 m above the ground, seen down to a share of its radius."""
    v, t = sphere(4000)
    seen = (v[t][:, :, 2] >= low).all(axis=1)
    used, index = np.unique(t[seen], return_inverse=True)
    at = v[used] + (0.0, 0.0, 0.6)
    body = body_of(
        at, index.reshape(-1, 3).astype(np.int32), v[used], None, 1.0, design_surface([0.0])
    )
    rng = np.random.default_rng(1)
    floor = np.column_stack([rng.uniform(-2, 2, (6000, 2)), np.zeros(6000)])
    away = np.hypot(*floor[:, :2].T)
    return body, floor[away > (0.8 if floor_under else 1.0)]


@pytest.mark.parametrize("low", [0.0, -0.2, -0.4])
def test_an_unseen_foot_that_bends_in_is_in_sigma(low):
    body, _ = lifted_ball(low, False)
    truth = np.pi * (2.0 / 3.0 + 0.6 - 0.6**3 / 3.0)
    doubt = np.sqrt(sum(c.doubt_m3**2 for c in body.closures))
    assert 0.0 < body.volume_m3 - truth < 2.0 * doubt < 0.5 * truth


def test_circles_and_tangents():
    bend, height = np.array([1.0, -1.0, 1e-4, 0.0, 2.0]), np.array([1.0, 1.0, 1.0, 1.0, 3.0])
    found = between_tangent_and_circle(bend, height)
    assert found[:3] == pytest.approx([1 - np.pi / 4, np.pi / 4 - 1, 1e-4 / 6], rel=1e-6)
    assert found[3] == 0.0 and found[4] == pytest.approx((1 - np.pi / 4) / 4)


def test_ground_seen_under_a_body_is_doubted():
    (body, under), (_, beside) = lifted_ball(0.0, True), lifted_ball(0.0, False)
    assert (
        share_of_ground_under(body, under, 0.05) > 0.1
        and share_of_ground_under(body, beside, 0.05) == 0.0
    )
    ground = design_surface([0.0])
    object.__setattr__(ground, "support", np.arange(len(under)))
    mesh = type("Mesh", (), {"report": {"spacing_m": 0.05}})()
    made = CloudBodies((body,), (np.arange(3),), (mesh,), (0,), ground)
    (doubt,) = foot_doubts(made, BodyPoints(under, None, None, None))
    assert doubt.name == "body_undercut" and "underside" in doubt.text
    # a ball that was closed like a bell: the truth lies within two of them
    (lines,) = shape_lines(made, BodyPoints(under, None, None, None))
    cap = np.pi * 0.4**2 * (3.0 - 0.4) / 3.0
    off = body.volume_m3 - (4.0 / 3.0 * np.pi - cap)
    assert lines == {"undercut": pytest.approx(body.closures[0].closed_m3 ** 2 / 3.0)}
    assert 0.0 < off < 2.0 * np.sqrt(lines["undercut"])


def test_edges_that_stay_cut_off_are_in_sigma():
    """Triangles along the faces of all their corners cut nothing off; where one corner's normal is
    that of another face, they do.
    """
    v, t = sphere(1000)
    body = body_of(v, t)
    assert cut_off_m2(body, v) == 0.0
    turned = v.copy()
    turned[0] = np.cross(v[0], (0.3, 0.5, 0.8))
    turned[0] /= np.linalg.norm(turned[0])
    around = t[(t == 0).any(axis=1)]
    a, b, c = (v[around[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert cut_off_m2(body, turned) == pytest.approx(area)
    assert cut_off_m2(body, -v) == 0.0


def test_a_thin_wall_that_half_of_its_points_do_not_make_is_refused():
    v, t = sphere(1000)
    disc = body_of(v * (1.0, 1.0, 0.05), t)
    planes = np.round(2.0 * v)  # coarse facets
    planes /= np.maximum(np.linalg.norm(planes, axis=1), 1e-9)[:, None]
    made = CloudBodies((disc,), (np.arange(len(v)),), (None,), (0,), None)
    f = type("Filtered", (), {"normal": planes, "reach": np.full(len(v), 0.3)})()
    points = BodyPoints(v, planes, None, None, 0.0, f)
    whole = FilterComparison(0.0, 0.0, (0.0,), 3)
    check_thin_walls(made, (whole,), points)
    with pytest.raises(SurfaceError) as error:
        check_thin_walls(made, (dataclasses.replace(whole, failure="a gap"),), points)
    assert error.value.reason == "body_thin_wall" and "a gap" in str(error.value)


def test_thin_walls_are_told_from_thick_ones():
    block = body_of(CUBE_V, CUBE_T)
    plate = body_of(CUBE_V * (1.0, 1.0, 0.05), CUBE_T)
    assert thin_share(block, 0.2) == 0.0
    v, t = sphere(1000)
    disc = body_of(v * (1.0, 1.0, 0.05), t)
    assert thin_share(disc, 0.2) > 0.5 and thin_share(body_of(v, t), 0.2) == 0.0
    assert plate.volume_m3 == pytest.approx(0.05)


def test_places_away_from_a_body():
    rng = np.random.default_rng(4)
    body, xy = rng.uniform(-1, 1, (400, 2)), rng.uniform(-4, 4, (3000, 2))
    far = away_from(xy, body, 0.3)
    nearest = np.sqrt(((xy[:, None] - body[None]) ** 2).sum(axis=2)).min(axis=1)
    assert (nearest[far] > 0.3).all() and far[nearest > 2 * np.sqrt(2) * 0.3].all()

"""Admission of points against the plain twins."""

import numpy as np
from scipy.spatial.transform import Rotation

from ladar_volume.georeference.point_jacobian import bracket
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.records import select
from ladar_volume.rmls import patch_twin, point_admission
from ladar_volume.rmls.viewing_geometry import KEPT, NUMBERS, store_geometry, viewing_geometry


def test_admission_and_geometry_are_those_of_the_twins(scene):
    rng = np.random.default_rng(0)
    states = scene.platform()
    states.q_map_body[::3] *= -1  # the same attitude
    states.omega_body[:] = rng.normal(size=states.omega_body.shape)
    states.segment[400:] = 1
    states.segment[700:710] = -1
    states.segment[710:] = 2
    states = select(states, rng.random(len(states)) < 0.8)
    n = 4000
    t = rng.integers(-100_000_000, 10_100_000_000, n)
    t[:1000] = np.sort(t[:1000])
    t[1000:1200] = rng.choice(states.t_ns, 200)
    t[1200:1202] = states.t_ns[[0, -1]]
    r, C = rng.normal(size=(n, 3)) * 10, np.ones((n, 6), np.float32)
    verdict, state, fraction = np.zeros(n, np.int8), np.zeros(n, np.int64), np.zeros(n)
    at = point_admission.Bracket(state, fraction)
    point_admission.admit(t, r, C, 1e6, states.t_ns, states.segment, verdict, at)
    covered, k, f = bracket(t, states.t_ns, states.segment)
    taken = verdict == point_admission.TAKEN
    assert np.array_equal(taken, covered) and 1000 < taken.sum() < n
    assert np.array_equal(state[taken], k[taken]) and np.array_equal(fraction[taken], f[taken])

    rows = np.flatnonzero(taken)
    seen, laser = np.zeros((len(rows), NUMBERS)), np.array([0.1, -0.2, 0.3])
    point_admission.geometry(
        rows,
        r,
        at,
        point_admission.StateArrays(
            states.p_map_body, states.q_map_body, states.v_body, states.omega_body
        ),
        laser,
        seen,
    )
    expected = patch_twin.geometry(r[rows], states, k[rows], f[rows], laser)
    same = np.where((seen[:, :4] * expected[:, :4]).sum(axis=1) < 0, -1.0, 1.0)
    assert np.abs(seen[:, :4] * same[:, None] - expected[:, :4]).max() < 1e-9
    assert np.abs(seen[:, 4:] - expected[:, 4:]).max() < 1e-7


def test_a_point_moves_with_a_platform_that_turns_and_drives():
    """By small steps of a rigid motion."""
    rng = np.random.default_rng(5)
    start, h = Rotation.random(random_state=6), 1e-6
    p, v, w, point = rng.normal(size=(4, 3)) * [[3.0], [2.0], [0.7], [20.0]]  # v, w: of the body
    arm = start.inv().apply(point - p)

    def place(t):
        turn = start * Rotation.from_rotvec(w * t)
        return p + start.apply(v) * t + turn.apply(arm)

    seen = np.zeros((1, NUMBERS))
    states = point_admission.StateArrays(*(a[None] for a in (p, start.as_quat(), v, w)))
    at = point_admission.Bracket(np.zeros(1, np.int64), np.zeros(1))
    point_admission.geometry(
        np.zeros(1, np.int64), point[None], at, states, np.array([0.1, 0.2, -0.1]), seen
    )
    np.testing.assert_allclose(seen[0, 7:], (place(h) - place(-h)) / (2.0 * h), rtol=1e-6)
    np.testing.assert_allclose(seen[0, 4:7], arm - [0.1, 0.2, -0.1])


def test_kept_geometry_is_rounded_to_its_own_units():
    """Against the numbers rounded one by one, from specks to beams of kilometres; NaN stays NaN."""
    rng = np.random.default_rng(1)
    g = rng.normal(size=(500, NUMBERS)) * 10.0 ** rng.uniform(-6, 4, (500, 1))
    g[:, :4] /= np.linalg.norm(g[:, :4], axis=1, keepdims=True)
    g[0, :4], g[1, 4:7], g[2, 7:] = [0, 0, 0, -1], 0.0, [-8.0, 0.1, 8.0]
    kept, back = np.empty((len(g), KEPT), np.int16), np.empty_like(g)
    store_geometry(g, kept)
    for i in range(len(g)):
        viewing_geometry(kept[i], back[i])
    q = np.rint(g[:, :4] * 32767)
    assert np.abs(back[:, :4] - q / np.linalg.norm(q, axis=1, keepdims=True)).max() < 1e-15
    for part in (slice(4, 7), slice(7, 10)):
        largest = np.abs(g[:, part]).max(axis=1, keepdims=True)
        unit = 2.0 ** (np.floor(np.log2(np.maximum(largest, 1e-300))) - 14)
        assert (
            np.abs(back[:, part] - np.minimum(np.rint(g[:, part] / unit), 32767) * unit).max()
            <= 1e-12
        )
        assert (np.abs(back[:, part] - g[:, part]) <= 2.0**-15 * largest).all()
    R, twin = matrix_from_quaternion(back[:, :4]), matrix_from_quaternion(g[:, :4])
    assert (
        np.arccos(np.clip((np.einsum("nii->n", np.swapaxes(R, 1, 2) @ twin) - 1) / 2, -1, 1)).max()
        < 6.2e-5
    )
    g[0, 5], g[1, 9] = np.nan, np.inf
    store_geometry(g[:2], kept[:2])
    viewing_geometry(kept[0], back[0])
    viewing_geometry(kept[1], back[1])
    assert (
        np.isnan(back[0, 4:7]).all()
        and np.isnan(back[1, 7:]).all()
        and np.isfinite(back[0, 7:]).all()
    )


def test_verdicts_name_the_reason(scene):
    states = scene.platform()
    r, C, t = np.zeros((6, 3)), np.zeros((6, 6), np.float32), np.full(6, 5_000_000_000)
    r[0, 0], r[1, 1], C[2, 5], r[3, 2], t[4] = np.nan, -np.inf, np.nan, -2e6, -1
    r[1, 2] = np.inf  # opposite infinities do not cancel
    verdict, at = np.zeros(6, np.int8), point_admission.Bracket(np.zeros(6, np.int64), np.zeros(6))
    point_admission.admit(t, r, C, 1e6, states.t_ns, states.segment, verdict, at)
    assert verdict.tolist() == [point_admission.NOT_FINITE] * 3 + [
        point_admission.TOO_FAR,
        point_admission.UNCOVERED,
        point_admission.TAKEN,
    ]


def test_a_patch_has_its_fewest_points(scene):
    xy = scene.sheet(60)
    points = scene.mapped(np.column_stack([xy, 0.001 * xy[:, 0]]))
    few, some = (scene.filtered(points, min_points=n)[1] for n in (59, 5))
    assert len(some.points) > 0 and len(few.points) == 0
    u = np.linspace(0.1, 0.4, 4)  # twelve in one voxel, about a plane, all of them inliers
    xy = np.array([(x, y) for x in u for y in u[:3]])
    z = 0.2 + 0.05 * xy[:, 0] + 0.002 * np.random.default_rng(2).normal(size=12)
    points = scene.mapped(np.column_stack([xy, z]))
    enough, one_short = (scene.filtered(points, min_points=n)[1] for n in (12, 13))
    assert len(enough.patches) == 1 and len(one_short.patches) == 0

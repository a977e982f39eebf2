"""Patches that were seen in more time bins than they have room for."""

import numpy as np
import pytest

from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.parameters import Parameters
from ladar_volume.rmls import patch_sensitivity, patch_twin
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.rmls.viewing_geometry import NUMBERS, viewing_geometry
from ladar_volume.rmls.voxel_store import pack_key


def test_fewer_bins_than_a_patch_is_seen_in(scene):
    """Against the sums written out: runs of bins, one inlier drawn from each, all of the run seen
    with its pose; over the patches the sums by time are those of all bins.
    """
    rng = np.random.default_rng(12)
    n, seconds = 2500, 60.0
    points = scene.mapped(
        np.column_stack([scene.sheet(n), 0.005 * rng.normal(size=n)]), seconds=seconds
    )
    states, most = scene.platform(seconds), 6
    f = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5, "degree": 1, "nav_bin_s": 2.0}}))
    f.add_platform(states)
    f.add(points)
    all_bins = f.finish().patches
    s = f.store
    rows = np.array([int(np.flatnonzero(s.keys[: s.used] == key)[0]) for key in all_bins.key])
    f.builder.most_bins = most
    few, fits = f.builder.patches(f.fits, rows), f.fits.with_inliers(rows, s)
    assert (np.diff(few.nav_start) == most).all() and np.diff(all_bins.nav_start).min() > 3 * most
    assert (
        few.M_cal.tobytes() == all_bins.M_cal.tobytes()
        and few.cross.tobytes() == all_bins.cross.tobytes()
    )
    drawn, pose, u = (
        np.zeros(most, np.int64),
        np.empty(NUMBERS),
        np.array([patch_sensitivity.fraction_of(key) for key in few.key]),
    )
    for j in range(0, len(few), 5):
        inliers = fits.members[fits.start[rows[j]] :][: fits.used[rows[j]]]
        bins = s.t_ns[inliers] // 2_000_000_000
        distinct = np.unique(bins)
        run = np.array(
            [
                next(g for g in range(most) if b < (g + 1) * len(distinct) // most)
                for b in np.searchsorted(distinct, bins)
            ]
        )
        patch_sensitivity.draw_per_run(run, most, u[j], drawn)
        X, _ = patch_twin.design(s.r[inliers], few.centre[j], few.normal[j], few.tangent[j], 1)
        weights = fits.weights[fits.start[rows[j]] :][: fits.used[rows[j]]].astype(float)
        solved, mean = patch_twin.solution(X, weights), (weights / weights.sum())[None, :]
        for g in range(most):
            own, d = run == g, drawn[g]
            seen = few.nav_start[j] + g
            assert run[d] == g and few.nav_bin[seen] == bins[d]
            viewing_geometry(s.aux[inliers[d]], pose)
            R = matrix_from_quaternion(pose[None, :4])[0]
            arm = (
                pose[4:7] + (s.r[inliers[own]] - s.r[inliers[d]]) @ R
            )  # of a mount without lever arms
            for k, (axis, w) in enumerate(
                (
                    (few.normal[j], solved),
                    (few.tangent[j], mean),
                    (np.cross(few.normal[j], few.tangent[j]), mean),
                )
            ):
                at = slice(0, 3) if k == 0 else slice(2 + k, 3 + k)
                assert few.M_nav[seen, at, 0] == pytest.approx(w[:, own].sum(axis=1), abs=2e-5)
                assert few.M_nav[seen, at, 1:] == pytest.approx(
                    w[:, own] @ np.cross(arm, axis @ R), abs=2e-4
                )
    # a common shift is what it was, and what all patches together do in a third of the time nearly
    # so
    for a in range(len(few)):
        parts = (p.M_nav[p.nav_start[a] : p.nav_start[a + 1], :, 0] for p in (few, all_bins))
        one, other = (part.sum(axis=0) for part in parts)
        assert one == pytest.approx(other, abs=1e-5)
    third = [
        np.stack([p.M_nav[p.nav_bin // 10 == k, 0].sum(axis=0) for k in range(3)]) / len(few)
        for p in (few, all_bins)
    ]
    assert np.abs(third[0] - third[1]).max() < 0.05 * np.abs(third[1]).max()


@pytest.mark.parametrize(
    "axes", [[[1, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, 0, 1]], [[0, 1, 0], [0, 0, 1]]]
)
def test_fractions_of_neighbours_lie_evenly(axes):
    corner, steps = (
        np.array([-400, 77, 3]),
        np.stack(np.meshgrid(range(6), range(6)), axis=-1).reshape(-1, 2),
    )
    u = np.sort(
        [patch_sensitivity.fraction_of(key) for key in pack_key(corner + steps @ np.array(axes))]
    )
    assert u[0] >= 0 and u[-1] < 1
    assert (
        np.abs(u - (np.arange(36) + 0.5) / 36).max() < 0.075
    )  # of 36 random numbers: 0.14 on average


def test_distinct_bins_are_those_of_sorted_times():
    rng = np.random.default_rng(3)
    for n in (1, 2, 40):
        t, members = rng.integers(-50, 50, 60) * 700_000_000, rng.permutation(60)[:n]
        bins = np.zeros(n, np.int64)
        m = patch_sensitivity.distinct_bins(members.astype(np.int32), n, t, 10**9, bins)
        assert np.array_equal(bins[:m], np.unique(t[members] // 10**9))

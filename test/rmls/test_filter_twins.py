"""The kernels against their plain numpy twins, and the sensitivities against the Jacobians of the
georeference.
"""

import numpy as np
import pytest

from ladar_volume.math import normal_equations
from ladar_volume.math.normal_equations import invert, select_kth
from ladar_volume.math.packed_covariance import unpack
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import MappedPoints
from ladar_volume.rmls import cross_covariance, patch_twin, projection
from ladar_volume.rmls.patch_fit import OK
from ladar_volume.rmls.surface_filter import SurfaceFilter


@pytest.fixture(params=[1, 2])
def fitted(scene, request):
    """A filter with everything switched on, its update and, per patch key, the inlier slots."""
    rng = np.random.default_rng(2)
    n = 900
    r = np.column_stack([scene.sheet(n, half=1.2), 0.01 * rng.normal(size=n)])
    r[:, 2] += 0.2 * r[:, 0] + 0.05 * r[:, 1] ** 2
    r[:60, 2] += 0.4
    points = scene.mapped(r)
    points.ring[points.ring == 5] = 4  # a beam without returns
    A = rng.normal(size=(n, 3, 3)) * 0.01
    C = A @ A.transpose(0, 2, 1) + 1e-6 * np.eye(3)
    points.C_ind[:] = C[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    f = SurfaceFilter(
        Parameters.read(
            {
                "filter": {
                    "radius_m": 0.5,
                    "degree": request.param,
                    "nav_bin_s": 2.0,
                    "cap_per_voxel": 20,
                },
                "calibration": {
                    "boresight_pitch_deg": 25.0,
                    "lever_laser_m": [0.1, -0.2, 0.3],
                    "lever_antenna_m": [-0.3, 0.1, 0.8],
                },
            }
        )
    )
    states = scene.platform()
    f.add_platform(states)
    f.add(points)
    update = f.finish()
    fits = f.builder.fit(f.dependent_voxels(np.arange(f.store.used)))
    slots = {
        int(f.store.keys[v]): np.sort(fits.members[fits.start[a] : fits.start[a] + fits.used[a]])
        for a, v in enumerate(fits.voxels)
        if fits.status[a] == OK
    }
    return f, update, slots, states, request.param


def rows(f, update, slots, j, degree):
    p = update.patches
    return patch_twin.design(
        f.store.r[slots[int(p.key[j])]], p.centre[j], p.normal[j], p.tangent[j], degree
    )


def stands_for(store, slot):
    """How many of the points offered to its voxel a held point stands for, by its highest hash."""
    v = slot // store.cap
    if store.count[v] < store.cap:
        return 1.0
    share = int(store.hashes[v * store.cap : (v + 1) * store.cap].max()) / 2**64
    return max(1.0, (store.cap - 1) / store.cap / share)


def weights_of(f, update, slots, j):
    own, s = slots[int(update.patches.key[j])], f.store
    stands = np.array([stands_for(s, slot) for slot in own])
    voxels = np.floor(s.r[own] / s.edge_m).astype(int)
    return patch_twin.thinning_weights(voxels, stands, update.patches.normal[j])


def solution_of(f, update, slots, j, degree):
    X, _ = rows(f, update, slots, j, degree)
    return patch_twin.solution(X, weights_of(f, update, slots, j))


def test_voxels_hold_what_they_were_offered_in_part(fitted):
    """Else the weights that the tests below compare would all be one."""
    f, update, slots, _, _ = fitted
    weights = np.concatenate([weights_of(f, update, slots, j) for j in range(len(update.patches))])
    assert weights.mean() == pytest.approx(1.0) and weights.min() < 0.8 and weights.max() > 1.2


def test_refit_is_least_squares_on_the_inliers(fitted):
    f, update, slots, _, degree = fitted
    p = update.patches
    assert len(p) > 15 and list(slots) == list(p.key)
    for j in range(len(p)):
        X, w = rows(f, update, slots, j, degree)
        assert p.used[j] == len(w)
        columns = np.count_nonzero(
            p.beta[j]
        )  # a neighbourhood that does not determine a quadric got a plane
        extra, gu, gv = patch_twin.arc(X, p.beta[j])
        weights = weights_of(f, update, slots, j)
        beta, inverse = patch_twin.least_squares(X[:, :columns], w - extra, weights)
        # the arc term follows the quadratic terms: it has settled to a thousandth of sigma, all
        # else is exact
        assert (
            np.abs(beta - p.beta[j][:columns])
            <= 1e-8 + 2e-3 * p.sigma[j] * np.sqrt(np.diag(inverse)) * (degree == 2)
        ).all()
        residual = (w - extra - X @ p.beta[j]) / np.sqrt(1 + gu**2 + gv**2)
        assert p.sigma[j] == pytest.approx(
            np.sqrt(weights @ residual**2 / (len(w) - columns)), rel=2e-3
        )
        assert np.abs(residual).max() <= 3.5 * p.sigma[j] * (1 + 2e-3)  # a fixed point
        assert p.normal[j] @ p.tangent[j] == pytest.approx(0, abs=1e-12)


def test_points_left_out_are_beyond_threshold_or_ball(fitted):
    f, update, slots, _, degree = fitted
    p, held = update.patches, np.flatnonzero(f.store.t_ns > 0)
    for j in range(len(p)):
        out = np.setdiff1d(held, slots[int(p.key[j])])
        X, w = patch_twin.design(f.store.r[out], p.centre[j], p.normal[j], p.tangent[j], degree)
        extra, gu, gv = patch_twin.arc(X, p.beta[j])
        d, slope = w - extra - X @ p.beta[j], 1 + gu**2 + gv**2
        threshold = 3.5 * p.sigma[j]
        reach = 1.0 if np.count_nonzero(p.beta[j]) == 3 else 1.0 - threshold
        foot = np.stack([X[:, 1] + d * gu / slope, X[:, 2] + d * gv / slope, w - d / slope], axis=1)
        assert (
            (np.linalg.norm(foot, axis=1) > reach * (1 - 2e-3))
            | (np.abs(d) / np.sqrt(slope) > threshold * (1 - 2e-3))
        ).all()


def test_cross_blocks_of_every_pair_that_shares_points(fitted):
    f, update, slots, _, degree = fitted
    p = update.patches
    at = {int(k): i for i, k in enumerate(p.key)}
    seen = 0
    for a in range(len(p)):
        stored = {
            int(k): p.cross[i]
            for i, k in enumerate(
                p.cross_key[p.cross_start[a] : p.cross_start[a + 1]], p.cross_start[a]
            )
        }
        assert p.cross_key[p.cross_start[a]] == p.key[a]
        sharing = {
            k for k in at if k >= p.key[a] and np.intersect1d(slots[int(p.key[a])], slots[k]).size
        }
        assert set(stored) == sharing
        solved = solution_of(f, update, slots, a, degree)
        for key, block in stored.items():
            b = at[key]
            C = patch_twin.shared_covariance(
                (solved, solution_of(f, update, slots, b, degree)),
                (p.normal[a], p.normal[b]),
                (slots[int(p.key[a])], slots[key]),
                f.store.C,
            )
            scale = np.sqrt(
                np.outer(np.diag(p.cross[p.cross_start[a]]), np.diag(p.cross[p.cross_start[b]]))
            )
            assert (np.abs(C - block) <= 1e-6 * scale).all()
            seen += a != b
    assert seen > 30


def test_sensitivities_are_those_of_the_lidar_equation(fitted):
    f, update, slots, states, degree = fitted
    p, s = update.patches, f.store
    for j in range(0, len(p), 3):
        inliers = slots[int(p.key[j])]
        points = MappedPoints(
            s.t_ns[inliers],
            s.r[inliers],
            s.C[inliers],
            s.ring[inliers],
            np.zeros(len(inliers), np.float32),
        )
        X, _ = rows(f, update, slots, j, degree)
        calibration = Parameters.read(
            {
                "calibration": {
                    "boresight_pitch_deg": 25.0,
                    "lever_laser_m": [0.1, -0.2, 0.3],
                    "lever_antenna_m": [-0.3, 0.1, 0.8],
                }
            }
        ).calibration
        weights = weights_of(f, update, slots, j)
        M_cal, bins, M_nav = patch_twin.mean_sensitivities(
            X,
            weights,
            (p.normal[j], p.tangent[j]),
            points,
            states,
            calibration,
            f.builder.beams,
            2_000_000_000,
        )
        nav = slice(p.nav_start[j], p.nav_start[j + 1])
        assert np.array_equal(bins, p.nav_bin[nav])
        # the geometry of each return is kept in 16 bits (see ``geometry``); means of many err by
        # less
        scale = (
            np.append(np.abs(patch_twin.solution(X, weights)).sum(axis=1), [1.0, 1.0])[:, None]
            * 20.0
        )
        assert (np.abs(M_cal - p.M_cal[j]) < 1e-5 * scale).all()
        assert (np.abs(M_nav - p.M_nav[nav])[..., 1:] < 1e-5 * scale).all()
        assert (
            np.abs(M_nav - p.M_nav[nav])[..., :1] < 1e-6 * scale
        ).all()  # the position's need none of it


def test_residuals_of_bins_and_of_beams_within_them(fitted):
    f, update, slots, _, degree = fitted
    p, s = update.patches, f.store
    for j in range(0, len(p), 3):
        inliers = slots[int(p.key[j])]
        X, w = rows(f, update, slots, j, degree)
        above = w - X @ p.beta[j] - patch_twin.arc(X, p.beta[j])[0]
        at = s.t_ns[inliers] // 2_000_000_000
        weights = weights_of(f, update, slots, j)
        by_bin = {b: np.average(above[at == b], weights=weights[at == b]) for b in np.unique(at)}
        nav = slice(p.nav_start[j], p.nav_start[j + 1])
        assert p.nav_residual[nav] == pytest.approx([by_bin[b] for b in p.nav_bin[nav]], abs=1e-7)
        left = above - np.array([by_bin[b] for b in at])
        for beam in range(f.builder.beams):
            own = s.ring[inliers] == beam
            mean = np.average(left[own], weights=weights[own]) if own.any() else 0.0
            assert p.beam_residual[j, beam] == pytest.approx(mean, abs=1e-7)
        voxel = int(np.flatnonzero(s.keys[: s.used] == p.key[j])[0])
        own = inliers // s.cap == voxel
        mean = above[own].mean() if own.any() else 0.0  # those of one voxel weigh alike
        assert p.own_residual[j] == pytest.approx(mean, abs=1e-7)


def test_common_shift_moves_only_the_constant_term(fitted):
    _, update, _, _, _ = fitted
    p = update.patches
    for j in range(len(p)):
        total = p.M_nav[p.nav_start[j] : p.nav_start[j + 1], :, 0].sum(axis=0)
        assert total[[0, -2, -1]] == pytest.approx(1.0, abs=1e-6)
        assert np.abs(total[1:-2]).max() < 2e-6


def test_points_lie_on_their_patch_with_its_variance(fitted):
    _, update, _, _, degree = fitted
    p, q = update.patches, update.points
    j = np.searchsorted(p.key, q.patch)
    assert np.array_equal(p.key[j], q.patch)
    for i in range(len(q)):
        X, w = patch_twin.design(
            q.r_map[i : i + 1], p.centre[j[i]], p.normal[j[i]], p.tangent[j[i]], degree
        )
        extra, _, _ = patch_twin.arc(X, p.beta[j[i]])
        assert w[0] == pytest.approx(X[0] @ p.beta[j[i]] + extra[0], abs=1e-10)
        cosine = q.normal[i] @ p.normal[j[i]]
        C = p.cross[p.cross_start[j[i]]]
        assert q.variance[i] == pytest.approx(X[0] @ C @ X[0] * cosine**2, rel=1e-8)


def test_points_have_the_normal_and_the_tangential_noise_of_their_patch(fitted):
    f, update, slots, _, degree = fitted
    p, q, edge = update.patches, update.points, 0.25  # half a radius
    own = {int(key): v for v, key in enumerate(f.store.keys[: f.store.used])}
    tilted = 0
    for i in range(len(q)):
        j = int(np.searchsorted(p.key, q.patch[i]))
        n, t, key = p.normal[j], p.tangent[j], int(p.key[j])
        s = np.cross(n, t)
        X, _ = patch_twin.design(q.r_map[i : i + 1], p.centre[j], n, t, degree)
        _, wu, wv = patch_twin.arc(X, p.beta[j])
        normal = n - wu[0] * t - wv[0] * s
        assert np.allclose(q.normal[i], normal / np.linalg.norm(normal), atol=1e-8)
        inside = slots[key][slots[key] // f.store.cap == own[key]]
        uv = patch_twin.design(f.store.r[inside], p.centre[j], n, t, 1)[0][:, 1:]
        cell = np.floor(uv / edge).astype(int)
        means = [
            (uv[same].mean(axis=0), inside[same])
            for same in ((cell == c).all(axis=1) for c in np.unique(cell, axis=0))
        ]
        mean, members = min(means, key=lambda m: np.abs(m[0] - q.local[i]).max())
        assert np.allclose(mean, q.local[i], atol=1e-12)
        total, P = unpack(f.store.C[members]).sum(axis=0), np.eye(3) - np.outer(n, n)
        wanted = (P @ total @ P)[np.triu_indices(3)] / len(members) ** 2
        assert np.allclose(q.C_tangent[i], wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())
        tilted += P[0, 2] ** 2 * total[2, 2] > 1e-3 * total[0, 0]
    assert tilted > len(q) / 2  # else the heights' noise would not show


def test_small_algebra_against_numpy():
    rng = np.random.default_rng(9)
    for p in (3, 6):
        A = rng.normal(size=(20, p))
        N = A.T @ A
        padded, inverse = np.zeros((6, 6)), np.zeros((6, 6))
        padded[:p, :p] = N
        assert invert(padded, p, inverse)
        assert np.allclose(inverse[:p, :p], np.linalg.inv(N), rtol=1e-9)
        padded[:p, 1] = padded[:p, 0]
        padded[1, :p] = padded[0, :p]
        padded[1, 1] = padded[0, 0]
        assert not invert(padded, p, inverse)
    for n in (1, 2, 7, 50):
        a = rng.integers(0, 9, n).astype(float)
        for k in range(n):
            assert select_kth(a.copy(), n, k) == np.sort(a)[k]


def test_eigenvectors_of_small_matrices():
    rng = np.random.default_rng(0)
    for case in range(300):
        A = rng.normal(size=(3, 3))
        turn = np.linalg.qr(A)[0]
        S = [
            A @ A.T * 10.0 ** rng.uniform(-8, 8),
            turn @ np.diag([1e-14, 1.0, 1.0]) @ turn.T,
            np.diag(rng.integers(0, 3, 3) * 1.0),
        ][case % 3]
        S = 0.5 * (S + S.T)
        value, vector = np.empty(3), np.empty((3, 3))
        normal_equations.eigen(S.copy(), value, vector)
        scale = max(np.abs(S).max(), 1e-300)
        assert (
            np.abs(value - np.linalg.eigvalsh(S)).max() < 1e-14 * scale
            and (np.diff(value) >= 0).all()
        )
        assert (
            np.abs(vector.T @ vector - np.eye(3)).max() < 1e-14
            and np.abs(S @ vector - vector * value).max() < 1e-14 * scale
        )


def test_noise_within_the_tangent_plane_beside_matrices():
    rng = np.random.default_rng(8)
    for size in (1, 7):
        A, n = rng.normal(size=(3, 3)), rng.normal(size=3)
        n /= np.linalg.norm(n)
        C, P, out = A @ A.T, np.eye(3) - np.outer(n, n), np.zeros(6)
        projection.tangential_covariance(C[np.triu_indices(3)], n, size, out)
        assert np.allclose(out, (P @ C @ P)[np.triu_indices(3)] / size**2, rtol=1e-12, atol=1e-15)


def test_slots_by_numbers_of_their_own():
    rng = np.random.default_rng(8)
    members = rng.choice([7, 8, 23, 60, 61, 62, 119], 40).astype(np.int32) * 5 + rng.integers(
        0, 5, 40
    ).astype(np.int32)
    local, slots = cross_covariance.local_slots(members, 5, 120)
    # numbers of the voxels in the order in which the members meet them
    _, first, voxel = np.unique(members // 5, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))[voxel]
    assert np.array_equal(local, 5 * rank + members % 5) and slots == 5 * len(first)

"""The cloud filter's kernels against plain numpy and scipy written from their descriptions."""

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

from ladar_volume.clouds.filter import (
    cell_records,
    cell_surface,
    orthogonal_quadric,
    plane_em,
    plane_set_selection,
    sharp_planes,
    single_surface,
)

SIGMA, THRESHOLD = 0.02, 0.06
SEEDS = range(6)


def some_planes(rng, count):
    """Planes near the origin as rows (n, o), none nearly parallel to another."""
    while True:
        n = rng.normal(size=(count, 3))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        c = np.abs(n @ n.T)[np.triu_indices(count, 1)]
        if c.max(initial=0.0) < 0.8:
            return np.column_stack([n, rng.uniform(-0.1, 0.1, count)])


def scene(seed, count=3, n=300):
    """Points about the pieces of planes on one side of each other each, and outliers; (x, planes
    (MOST, 4), side (MOST, MOST)).
    """
    rng = np.random.default_rng(seed)
    planes = np.zeros((sharp_planes.MOST, 4))
    planes[:count] = some_planes(rng, count)
    side = np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64)
    for a, b in itertools.permutations(range(count), 2):
        side[a, b] = rng.choice([-1, 0, 1])
    x = rng.uniform(-0.5, 0.5, (n, 3))
    which = rng.integers(0, count + 1, n)
    for a in range(count):
        own = which == a
        x[own] -= (x[own] @ planes[a, :3] - planes[a, 3] - rng.normal(0, SIGMA, own.sum()))[
            :, None
        ] * planes[a, :3]
    return x, planes, side


def sample_of(x):
    """All of the points (n, 3) as the kernels want them."""
    return cell_records.PointSample(x, len(x), len(x), SIGMA, THRESHOLD)


def pieces_with(x, planes, side):
    """The pieces of given planes, for points (n, 3)."""
    pieces = cell_records.pieces_of(len(x))
    pieces.planes[:], pieces.side[:] = planes, side
    return pieces


def room_of(x):
    """side and label as working arrays."""
    pieces = cell_records.pieces_of(len(x))
    return cell_records.PieceBounds(pieces.side, pieces.label)


def off(x, planes):
    return x @ planes[:, :3].T - planes[:, 3]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_nearest_point_of_a_half_plane_is_that_of_an_optimiser(seed):
    x, planes, side = scene(seed, 2)
    side[0, 1] = 1
    for p in x[:15]:
        *q, on = sharp_planes.nearest_on_piece(p, 0, planes, 2, side)
        rules = [
            {"type": "eq", "fun": lambda y: y @ planes[0, :3] - planes[0, 3]},
            {"type": "ineq", "fun": lambda y: y @ planes[1, :3] - planes[1, 3]},
        ]
        best = minimize(
            lambda y, p=p: 100 * np.sum((y - p) ** 2),
            p,
            constraints=rules,
            method="SLSQP",
            options={"ftol": 1e-14},
        ).x
        assert np.abs(np.array(q) - best).max() < 1e-5
        assert on == int(abs(np.array(q) @ planes[1, :3] - planes[1, 3]) < 1e-9)


def test_the_nearest_point_of_an_octant_s_face_is_clipped():
    planes, side = (
        np.zeros((sharp_planes.MOST, 4)),
        np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64),
    )
    planes[:3, :3] = np.eye(3)
    side[:3, :3] = 1 - np.eye(3, dtype=np.int64)
    rng = np.random.default_rng(1)
    for p in rng.uniform(-1, 1, (200, 3)):
        *q, on = sharp_planes.nearest_on_piece(p, 2, planes, 3, side)
        assert (
            np.abs(np.array(q) - [max(p[0], 0), max(p[1], 0), 0]).max() < 1e-12
            and on == (p[:2] < 0).sum()
        )
        q = np.empty(3)
        which, square, _ = sharp_planes.nearest_piece(p, planes, 3, side, q)
        feet = np.array(
            [
                [0, max(p[1], 0), max(p[2], 0)],
                [max(p[0], 0), 0, max(p[2], 0)],
                [max(p[0], 0), max(p[1], 0), 0],
            ]
        )
        assert (
            square == pytest.approx(((feet - p) ** 2).sum(axis=1).min())
            and np.abs(feet[which] - q).max() < 1e-12
        )


@pytest.mark.parametrize("seed", SEEDS)
def test_sides_are_told_by_the_points_clear_of_the_other_plane(seed):
    x, planes, _ = scene(seed)
    d = off(x, planes[:3])
    label = np.where(np.abs(d).min(axis=1) < THRESHOLD, np.abs(d).argmin(axis=1), -1)
    side = np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64)
    sharp_planes.bounding_sides(x, len(x), label, planes, 3, SIGMA, side)
    for a, b in itertools.permutations(range(3), 2):
        clear = d[(label == a) & (np.abs(d[:, b]) > 2 * SIGMA), b]
        above, below = (clear > 0).sum(), (clear <= 0).sum()
        told = (
            len(clear) >= sharp_planes.CLEAR
            and min(above, below) <= sharp_planes.STRAY * len(clear) + sharp_planes.STRAYS
        )
        assert side[a, b] == (int(np.sign(above - below)) if told else 0)


def cost(x, planes, count, side):
    """Truncated squares to the pieces, and what saying takes; number of points nearest to each."""
    d2, inside = np.empty((len(x), count)), np.empty((len(x), count), bool)
    for i, p in enumerate(x):
        for a in range(count):
            *q, on = sharp_planes.nearest_on_piece(p, a, planes, count, side)
            d2[i, a], inside[i, a] = np.sum((p - q) ** 2), on == 0
    within = (inside & (d2 < THRESHOLD**2)).sum(axis=1)
    saying = 2 * SIGMA**2 * np.log(np.maximum(within, 1)).sum()
    near = d2.min(axis=1) < THRESHOLD**2
    return (
        np.minimum(d2.min(axis=1), THRESHOLD**2).sum(),
        saying,
        np.bincount(d2.argmin(axis=1)[near], minlength=count),
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_description_length(seed):
    x, planes, side = scene(seed)
    support = np.zeros(sharp_planes.MOST, np.int64)
    length, square = plane_em.pieces_cost(sample_of(x), planes, 3, side, np.inf, support)
    truncated, saying, near = cost(x, planes, 3, side)
    assert square == pytest.approx(truncated, rel=1e-12) and length == pytest.approx(
        truncated + saying, rel=1e-12
    )
    assert np.array_equal(support[:3], near)


@pytest.mark.parametrize("seed", SEEDS)
def test_shares_are_the_likelihoods(seed):
    x, planes, side = scene(seed)
    shares, pieces = plane_em.room_for_shares(len(x)), pieces_with(x, planes, side)
    plane_em.membership_shares(sample_of(x), pieces, 3, shares)
    share, label = shares.share, pieces.label
    d = off(x, planes[:3])
    feet = x[:, None] - d[:, :, None] * planes[None, :3, :3]
    heights = np.einsum("nak,bk->nab", feet, planes[:3, :3]) - planes[:3, 3]
    own = ((side[None, :3, :3] * heights >= 0) | (side[None, :3, :3] == 0)).all(axis=2) & (
        np.abs(d) <= THRESHOLD
    )
    weight = np.where(own, np.exp(-0.5 * (d / SIGMA) ** 2), 0.0)
    none = np.exp(-0.5 * (THRESHOLD / SIGMA) ** 2)
    expected = (
        weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300) * weight / (weight + none)
    )
    assert np.abs(share[:3].T - expected).max() < 1e-12
    assert np.array_equal(label, np.where(weight.max(axis=1) > none, weight.argmax(axis=1), -1))


@pytest.mark.parametrize(("count", "inward"), [(2, -1), (2, 1), (3, -1)])
def test_shares_pull_no_plane_off_where_planes_meet(count, inward):
    """Planes x_a = 0 that end at each other, normal noise: the expected sum of shares times
    distances vanishes for each, by quadrature, but for what the threshold cuts off.
    """
    planes, side = (
        np.zeros((sharp_planes.MOST, 4)),
        np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64),
    )
    planes[:count, :count] = np.eye(count)
    side[:count, :count] = inward * (1 - np.eye(count, dtype=np.int64))
    line = SIGMA * (np.arange(-40, 40) + 0.5) / 10  # over four sigma to either side of the planes
    x = np.zeros((len(line) ** count, 3))
    x[:, :count] = np.stack(np.meshgrid(*[line] * count, indexing="ij"), axis=-1).reshape(-1, count)
    density = np.zeros(len(x))
    for a in range(count):
        on = np.all(np.delete(x[:, :count], a, axis=1) * inward > 0, axis=1)
        density += on * np.exp(-0.5 * (x[:, a] / SIGMA) ** 2)
    shares = plane_em.room_for_shares(len(x))
    plane_em.membership_shares(sample_of(x), pieces_with(x, planes, side), count, shares)
    share = shares.share
    pull = (share[:count] * density) @ x[:, :count]
    assert np.abs(np.diagonal(pull)).max() < 2e-3 * SIGMA * (share[0] * density).sum()


@pytest.mark.parametrize("seed", SEEDS)
def test_two_planes_in_one_slab_become_one(seed):
    """Also where the noise is uniform and six per cent larger than believed; what is left is the
    plane of its points.
    """
    rng = np.random.default_rng(seed)
    x = np.column_stack(
        [rng.uniform(-0.5, 0.5, (600, 2)), rng.uniform(-1, 1, 600) * np.sqrt(3) * 1.06 * SIGMA]
    )
    pieces = cell_records.pieces_of(len(x))
    planes = pieces.planes
    for k, tilt in enumerate(rng.uniform(0.02, 0.15, 2) * [1, -1]):
        planes[k] = np.sin(tilt), 0.0, np.cos(tilt), rng.uniform(-0.5, 0.5) * SIGMA
    assert plane_em.refine(sample_of(x), 0.7, pieces, 2, 8, 0.0) == 1
    height, *slope = np.linalg.lstsq(
        np.column_stack([np.ones(len(x)), x[:, :2]]), x[:, 2], rcond=None
    )[0]
    assert (
        np.abs(planes[0, :2] / planes[0, 2] + slope).max() < 3e-3
        and abs(planes[0, 3] / planes[0, 2] - height) < 1e-3
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_weighted_planes_are_those_of_a_singular_value_decomposition(seed):
    rng = np.random.default_rng(seed)
    x, share = rng.normal(size=(60, 3)) * [1.0, 0.7, 0.05], rng.uniform(0, 1, 60)
    plane, mean, inverse = np.array([0.0, 0.0, 1.0, 0.0]), np.empty(3), np.empty((3, 3))
    total = sharp_planes.fit_shares(x, 60, share, plane, mean, inverse)
    middle = share @ x / share.sum()
    _, s, vt = np.linalg.svd((x - middle) * np.sqrt(share)[:, None])
    assert total == pytest.approx(share.sum()) and np.abs(mean - middle).max() < 1e-14
    assert abs(abs(plane[:3] @ vt[2]) - 1) < 1e-12 and plane[3] == pytest.approx(plane[:3] @ middle)
    assert np.abs(inverse - (vt[:2].T / s[:2] ** 2) @ vt[:2]).max() < 1e-10


@pytest.mark.parametrize("seed", SEEDS)
def test_few_planes_are_the_best_of_all_sets(seed):
    x, planes, _ = scene(seed, 3, 240)
    rng = np.random.default_rng([seed, 9])
    few = np.concatenate(
        [planes[:3] + rng.normal(0, [0.01, 0.01, 0.01, 0.004], (3, 4)), some_planes(rng, 3)]
    )
    few[:, :3] /= np.linalg.norm(few[:, :3], axis=1, keepdims=True)
    out, side = (
        np.zeros((sharp_planes.MOST, 4)),
        np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64),
    )
    m, need = len(x), 8
    count, length = plane_set_selection.best_small_set(sample_of(x), few, need, 3, out, room_of(x))
    best = (THRESHOLD**2 * m, 0, None)
    for size in (1, 2, 3):
        for chosen in itertools.combinations(range(len(few)), size):
            trial = np.zeros((sharp_planes.MOST, 4))
            trial[:size] = few[list(chosen)]
            d = np.abs(off(x, trial[:size]))
            near = np.where(d.min(axis=1) < THRESHOLD, d.argmin(axis=1), -1)
            sharp_planes.bounding_sides(x, m, near, trial, size, SIGMA, side)
            truncated, saying, support = cost(x, trial, size, side)
            total = truncated + saying + 3 * size * np.log(m) * SIGMA**2
            if support.min() >= need and total < best[0]:
                best = (total, size, trial)
    assert count == best[1] and length == pytest.approx(best[0], rel=1e-12)
    assert np.array_equal(out[:count], best[2][:count])


@pytest.mark.parametrize("seed", SEEDS)
def test_distinct_candidates_are_taken_greedily_while_they_pay(seed):
    x, planes, _ = scene(seed)
    rng = np.random.default_rng([seed, 3])
    offered = np.repeat(planes[:3], 4, axis=0)
    offered[:, 3] += rng.normal(0, 0.004, 12)
    out, limit, worth = np.empty((plane_set_selection.TRIED, 4)), THRESHOLD**2, 0.01
    number = plane_set_selection.greedy_candidates(sample_of(x), offered, worth, out)
    square, left, taken = off(x, offered).T ** 2, np.full(len(x), limit), []
    while len(taken) < len(out):
        sums = np.minimum(left, square).sum(axis=1)
        if sums.min() >= left.sum() - worth:
            break
        taken.append(int(sums.argmin()))
        left = np.minimum(left, square[taken[-1]])
    assert number == len(taken) and np.array_equal(out[:number], offered[taken])


def test_evenly_filled_space_is_clutter_and_a_plane_among_as_many_outliers_is_not():
    rng = np.random.default_rng(2)
    x = rng.uniform(-0.5, 0.5, (400, 3))
    out, room = np.zeros((sharp_planes.MOST, 4)), room_of(x)
    few = some_planes(rng, 5)
    none = plane_set_selection.best_small_set(sample_of(x), few, 12, 3, out, room)
    assert none == (0, np.inf)
    x[:200] -= (off(x[:200], few[:1]) - rng.normal(0, SIGMA, (200, 1))) * few[:1, :3]
    count, _ = plane_set_selection.best_small_set(sample_of(x), few, 12, 3, out, room)
    assert count >= 1 and np.array_equal(out[0], few[0])


@pytest.mark.parametrize("seed", SEEDS)
def test_a_quadric_by_orthogonal_distances_is_that_of_an_optimiser(seed):
    """On a paraboloid of little curvature, where the height of the arc over its quadric is below a
    micrometre.
    """
    rng = np.random.default_rng(seed)
    n, ball = 200, 1.0
    true = np.array([0.01, 0.02, -0.03, 0.03, 0.01, -0.02])
    u, v = rng.uniform(-0.6, 0.6, (2, n))
    x = np.column_stack(
        [u, v, np.stack([np.ones(n), u, v, u * u, u * v, v * v]).T @ true]
    ) + rng.normal(0, 0.005, (n, 3))
    near = np.vstack([x[:, 0] / ball, x[:, 1] / ball, x[:, 2], np.zeros(n)])
    beta, inverse = true * 0.5, np.zeros((6, 6))
    used, square = orthogonal_quadric.geometric_refit(near, n, ball, 0.1, 50, 0.005, beta, inverse)

    def distances(b):
        """By feet found to rounding."""
        p, q = x[:, 0].copy(), x[:, 1].copy()
        for _ in range(60):
            h = b[0] + b[1] * p + b[2] * q + b[3] * p * p + b[4] * p * q + b[5] * q * q
            gp, gq = b[1] + 2 * b[3] * p + b[4] * q, b[2] + b[4] * p + 2 * b[5] * q
            t = (x[:, 2] - h + gp * (p - x[:, 0]) + gq * (q - x[:, 1])) / (1 + gp**2 + gq**2)
            p, q = x[:, 0] + t * gp, x[:, 1] + t * gq
        return t * np.sqrt(1 + gp**2 + gq**2)

    best = least_squares(distances, true, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    assert used == n and np.abs(beta - best).max() < 2e-5
    assert square == pytest.approx(np.mean(distances(best) ** 2), rel=1e-4)


def test_support_counts_the_points_around():
    rng = np.random.default_rng(3)
    x, origin = rng.normal(size=(50, 3)), np.array([10.0, -5.0, 2.0])
    for q in rng.normal(size=(40, 3)) + origin:
        near = (((x + origin - q) ** 2).sum(axis=1) <= 0.7).sum()
        assert cell_surface.is_supported(x, 50, origin, q, 0.7) == (near > cell_surface.SUPPORT)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_gain_of_bending_is_that_of_a_regression(seed):
    rng = np.random.default_rng(seed)
    x = np.column_stack([rng.uniform(-1, 1, (80, 2)), rng.normal(0, 0.02, 80)])
    x[:, 2] += 0.02 * x[:, 0] ** 2
    plane, mean, inverse, label = (
        np.array([0.0, 0, 1, 0]),
        np.empty(3),
        np.empty((3, 3)),
        np.zeros(80, np.int64),
    )
    sharp_planes.fit_plane(x, 80, label, 0, plane, mean, inverse)
    d, e = x @ plane[:3] - plane[3], np.linalg.svd(plane[None, :3])[2][1:]
    u, v = (x - mean) @ e.T @ np.eye(2)[0], (x - mean) @ e.T @ np.eye(2)[1]
    X = np.stack([np.ones(80), u, v, u * u, u * v, v * v]).T
    left = d - X @ np.linalg.lstsq(X, d, rcond=None)[0]
    assert single_surface.curvature_gain(x, 80, label, plane, mean, 1.0) == pytest.approx(
        d @ d - left @ left, rel=1e-8
    )

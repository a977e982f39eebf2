"""The planes that neighbourhoods agree in: kernels against plain numpy, and a ledge of which no
single set has all three faces.
"""

import numpy as np
import pytest

from ladar_volume.clouds.filter import (
    cell_records,
    plane_agreement,
    plane_set_selection,
    sharp_planes,
)

SIGMA, THRESHOLD, REACH, LEAST = 0.02, 0.06, 0.25, 10
SEEDS = range(4)


def normalised(planes):
    return planes / np.linalg.norm(planes[..., :3], axis=-1, keepdims=True)


def some_sets(rng, planes, number):
    """Sets (number, MOST, 4) of two or three of the planes, each seen a little differently and
    facing either way, and their sizes.
    """
    sets, sizes = np.zeros((number, sharp_planes.MOST, 4)), rng.integers(2, 4, number)
    for a, size in enumerate(sizes):
        chosen = rng.permutation(len(planes))[:size]
        seen = normalised(planes[chosen] + rng.normal(0, [0.01, 0.01, 0.01, 0.003], (size, 4)))
        sets[a, :size] = seen * rng.choice([-1.0, 1.0], (size, 1))
    return sets, sizes


def ledge(rng, n=900):
    """Points within half a metre of two parallel faces 0.2 m apart and of the riser between them,
    and the three planes.
    """
    planes = np.array([[0, -1.0, 0, 0], [1.0, 0, 0, 0], [0, 1.0, 0, 0.2]])
    which = rng.choice(3, n, p=[0.42, 0.16, 0.42])
    x = np.column_stack([rng.uniform(0, 0.5, n), rng.uniform(0, 0.2, n), rng.uniform(-0.4, 0.4, n)])
    x[which == 0, 0] *= -1
    for k, plane in enumerate(planes):
        own = which == k
        x[own] += (plane[3] - x[own] @ plane[:3] + rng.uniform(-1.7, 1.7, own.sum()) * SIGMA)[
            :, None
        ] * plane[:3]
    return np.ascontiguousarray(x), planes


def room(x):
    """side and label as the kernels want them."""
    return cell_records.PieceBounds(
        np.zeros((sharp_planes.MOST, sharp_planes.MOST), np.int64), np.empty(len(x), np.int64)
    )


def sample_of(x):
    return cell_records.PointSample(x, len(x), len(x), SIGMA, THRESHOLD)


def like(a, b, limit):
    s = 1.0 if a[:3] @ b[:3] > 0 else -1.0
    return abs(a[3] - s * b[3]) + REACH * np.linalg.norm(a[:3] - s * b[:3]) < limit


def has(planes, wanted):
    return all(any(like(p, w, SIGMA) for p in planes) for w in wanted)


@pytest.mark.parametrize("seed", SEEDS)
def test_planes_that_are_the_same_are_nowhere_farther_apart(seed):
    rng = np.random.default_rng(seed)
    a = normalised(rng.normal(size=(40, 4)) * [1, 1, 1, 0.1])
    b = normalised(a + rng.normal(0, [0.05, 0.05, 0.05, 0.02], (40, 4))) * rng.choice(
        [-1.0, 1.0], (40, 1)
    )
    found = [
        plane_set_selection.planes_coincide(p, q, REACH, 0.04) for p, q in zip(a, b, strict=True)
    ]
    assert found == [like(p, q, 0.04) for p, q in zip(a, b, strict=True)] and 0 < sum(found) < 40
    for p, q in ((p, q) for p, q, s in zip(a, b, found, strict=True) if s):
        on = rng.normal(size=(200, 3)) * 0.2
        on -= (on @ p[:3] - p[3])[:, None] * p[:3]
        on = on[np.linalg.norm(on, axis=1) < REACH]
        assert np.abs(on @ q[:3] - q[3]).max(initial=0.0) < 0.04


@pytest.mark.parametrize("seed", SEEDS)
def test_repeated_sets_and_votes_against_plain_loops(seed):
    rng = np.random.default_rng(seed)
    sets, sizes = some_sets(rng, normalised(rng.normal(size=(4, 4)) * [1, 1, 1, 0.1]), 12)
    known = cell_records.NeighbourSets(sets, sizes)
    wide = 0.03
    for a in range(12):
        plain = any(
            sizes[b] == sizes[a]
            and all(any(like(p, q, wide) for q in sets[b, : sizes[b]]) for p in sets[a, : sizes[a]])
            for b in range(a)
        )
        assert plane_set_selection.repeats_earlier_set(known, a, REACH, wide) == plain
    each = np.concatenate([s[:n] for s, n in zip(sets, sizes, strict=True)])
    votes = np.array(
        [sum(like(p, q, plane_agreement.AGREE * SIGMA) or p is q for q in each) for p in each]
    )
    expected = []
    while len(expected) < sharp_planes.MOST and votes.any():
        expected.append(each[np.argmax(votes)])
        votes[[like(p, expected[-1], plane_agreement.APART * SIGMA) for p in each]] = 0
    out = np.zeros((sharp_planes.MOST, 4))
    assert plane_agreement.planes_by_vote(known, REACH, SIGMA, out) == len(
        expected
    ) and np.array_equal(out[: len(expected)], expected)
    planes = np.concatenate([expected[:1], normalised(rng.normal(size=(1, 4)))])
    share = [
        sum(
            any(like(p, q, plane_agreement.AGREE * SIGMA) for q in s[:n])
            for s, n in zip(sets, sizes, strict=True)
        )
        for p in planes
    ]
    for count in (1, 2):
        plain = min(share[:count]) >= max(plane_agreement.VOTES, 12 / plane_agreement.OF)
        assert plane_agreement.neighbours_agree(planes, count, known, REACH, SIGMA) == plain


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_left_without_each_plane(seed):
    rng = np.random.default_rng(seed)
    x, limit = rng.normal(size=(203, 3)) * 0.05, THRESHOLD**2
    planes = normalised(rng.normal(size=(5, 4)) * [1, 1, 1, 0.02])
    square = np.minimum((x @ planes[:, :3].T - planes[:, 3]) ** 2, limit)
    for size in (1, 2, 5):
        out = np.full(size, np.nan)
        plane_agreement.leave_one_out_squares(x, len(x), planes, size, limit, out)
        expected = [
            np.delete(square[:, :size], k, axis=1).min(axis=1, initial=limit).sum()
            for k in range(size)
        ]
        assert out == pytest.approx(expected, rel=1e-12)
    for n in (0, 1, 7, 8, 203):
        total = plane_set_selection.sum_of_minima(square[:n, 0].copy(), square[:n, 1].copy(), n)
        assert total == pytest.approx(np.minimum(square[:n, 0], square[:n, 1]).sum(), rel=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_planes_that_explain_nothing_go_one_at_a_time(seed):
    rng = np.random.default_rng(seed)
    x, true = ledge(rng)
    bounds, sample = room(x), sample_of(x)
    planes = np.zeros((sharp_planes.MOST, 4))
    planes[:6] = np.concatenate(
        [true, normalised(rng.normal(size=(2, 4)) * [1, 1, 1, 0.1]), [[0, 0, 1.0, 5.0]]]
    )
    given = planes.copy()
    assert plane_agreement.drop_unsupported(
        sample, planes, 6, 5, bounds.label
    ) == 5 and np.array_equal(planes[:5], given[:5])
    left, length = list(range(5)), None

    def cost(rows):
        trial = np.zeros((sharp_planes.MOST, 4))
        trial[: len(rows)] = given[rows]
        return plane_set_selection.description_length(sample, trial, len(rows), 0, np.inf, bounds)

    length = cost(left)
    while len(left) > 1:
        lengths = [cost([r for r in left if r != k]) for k in left]
        if min(lengths) >= length:
            break
        length = min(lengths)
        left.pop(int(np.argmin(lengths)))
    size = plane_agreement.drop_superfluous(sample, planes, 5, bounds)
    assert (
        size == len(left) == 3 and np.array_equal(planes[:size], given[left]) and left == [0, 1, 2]
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_a_ledge_of_which_every_neighbour_sees_two_faces(seed):
    rng = np.random.default_rng(seed)
    x, true = ledge(rng)
    bounds, sample = room(x), sample_of(x)
    pairs = np.array([[0, 1], [0, 1], [1, 2], [1, 2], [0, 2], [0, 2]])
    lent, sizes = np.zeros((6, sharp_planes.MOST, 4)), np.full(6, 2)
    for a, pair in enumerate(pairs):
        lent[a, :2] = normalised(true[pair] + rng.normal(0, [0.005, 0.005, 0.005, 0.001], (2, 4)))
    planes, own = np.zeros((sharp_planes.MOST, 4)), x[:60]
    sets = cell_records.NeighbourSets(lent, sizes)
    count, cost = plane_set_selection.best_neighbour_set(sample, REACH, sets, LEAST, planes, bounds)
    assert count == 2
    best = cell_records.BestSet(count, cost, 0)
    count = plane_agreement.consensus_planes(sample, own, REACH, sets, best, LEAST, planes, bounds)
    assert count == 3 and has(planes[:3], true)
    # where all agree and nothing is left to explain, nothing changes
    whole = np.zeros((6, sharp_planes.MOST, 4))
    whole[:, :3] = true
    before = planes.copy()
    again = plane_agreement.consensus_planes(
        sample,
        own,
        REACH,
        cell_records.NeighbourSets(whole, np.full(6, 3)),
        cell_records.BestSet(3, np.inf, 0),
        LEAST,
        planes,
        bounds,
    )
    assert again == 3 and np.array_equal(planes, before)

"""The k nearest points against brute force, in any order and with any ties."""

from collections import defaultdict

import numpy as np
import pytest

from ladar_volume.clouds.sampling.isolation import second_neighbour_distance
from ladar_volume.math.nearest import collect, kth_square, nearest, nearest_index
from ladar_volume.math.space_curve import BITS, FULL, curve_order
from ladar_volume.model.records import F64
from ladar_volume.tin.insertion_order import hilbert_order

RNG = np.random.default_rng(5)
EVEN = RNG.uniform(0, 10, (700, 3))
CLOUDS = {
    "even": EVEN,
    "along a curve": EVEN[hilbert_order(EVEN[:, :2])],
    "on a lattice": np.stack(np.meshgrid(*[np.arange(9.0)] * 3), -1).reshape(-1, 3),
    "at one place": np.ones((300, 3)),
    "two clumps far apart": np.r_[EVEN[:200], EVEN[200:] + 1e6],
    "uneven": EVEN * np.exp(RNG.normal(0, 4, (700, 1))),
    "on a line": np.c_[np.arange(100.0), np.zeros((100, 2))],
    "just as many": EVEN[:17],
}


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("k", [1, 9, 17])
def test_nearest_are_those_of_brute_force(name: str, k: int) -> None:
    points = CLOUDS[name]
    for places in (points, points[::-7] + 0.3, np.array([[1e9, 0, 0], [0, 0, 0.0]])):
        rows, far = nearest(nearest_index(points), places, k)
        square = ((places[:, None] - points) ** 2).sum(axis=2)
        own = np.take_along_axis(square, rows.astype(np.int64), axis=1)
        wanted = np.sort(square, axis=1)[:, :k]
        assert np.allclose(np.sort(own, axis=1), wanted, rtol=1e-13, atol=0)
        assert np.allclose(far, np.sqrt(wanted[:, -1]), rtol=1e-13, atol=0)
        assert (np.diff(np.sort(rows, axis=1), axis=1) > 0).all()


def test_of_points_equally_far_the_first_are_taken() -> None:
    points = CLOUDS["on a lattice"]
    rows, _ = nearest(nearest_index(points), points, 9)
    square = ((points[:, None] - points) ** 2).sum(axis=2)
    wanted = np.argsort(square, axis=1, kind="stable")[:, :9]
    assert np.array_equal(np.sort(rows, axis=1), np.sort(wanted, axis=1))


def test_more_neighbours_than_points_are_refused() -> None:
    with pytest.raises(ValueError, match="9 neighbours of 8 points"):
        nearest(nearest_index(np.zeros((8, 3))), np.zeros((1, 3)), 9)


def plain_order(points: F64, rows: list[int]) -> list[int]:
    """Rows in the order of the interleaved bits of their cells in the rows' own cube; a full cell
    in the order of its own, others by x, y, z.
    """
    low, size = points[rows].min(axis=0), np.ptp(points[rows], axis=0).max()
    cells = defaultdict(list)
    for i in rows:
        at = ((points[i] - low) * (2.0**BITS / max(size, 1e-280))).astype(np.int64)
        bits = zip(*(f"{c:0{BITS}b}" for c in at.clip(0, 2**BITS - 1)), strict=True)
        cells["".join("".join(b) for b in bits)].append(i)
    out: list[int] = []
    for _, cell in sorted(cells.items()):
        full = FULL < len(cell) < len(rows)
        out += plain_order(points, cell) if full else sorted(cell, key=lambda i: tuple(points[i]))
    return out


def test_the_curve_interleaves_the_bits_of_cells() -> None:
    for points in (EVEN, CLOUDS["uneven"], CLOUDS["at one place"]):
        assert np.array_equal(curve_order(points), plain_order(points, list(range(len(points)))))
    assert len(curve_order(np.zeros((0, 3)))) == 0


def test_the_curve_does_not_depend_on_the_order_of_the_points() -> None:
    rng = np.random.default_rng(3)
    tiny = rng.normal(size=(300, 3)) * 1e-4
    clouds = [
        # all but one in one cell
        np.vstack([tiny, tiny + np.array([1.0, 0.0, 0.0]), [[1e9, 0.0, 0.0]]]),
        np.repeat(rng.normal(size=(50, 3)), 30, axis=0),
        np.vstack([rng.normal(size=(40, 3)), np.array([1.0, 2.0, 3.0]) + 1e-9 * tiny[:5]]),
        1e-300 * rng.normal(size=(100, 3)),
    ]
    for points in clouds:
        order = curve_order(points)
        assert np.array_equal(np.sort(order), np.arange(len(points)))
        mixed = points[rng.permutation(len(points))]
        assert np.array_equal(mixed[curve_order(mixed)], points[order])
    near = clouds[0][curve_order(clouds[0])]
    steps = np.linalg.norm(np.diff(near[:600], axis=0), axis=1)
    assert np.median(steps) < 1e-4  # what is along the curve is near, too


def test_the_second_neighbour_is_that_of_brute_force() -> None:
    far = np.sqrt(((EVEN[:, None] - EVEN) ** 2).sum(axis=2))
    wanted = np.sort(far, axis=1)[:, 2]
    assert np.allclose(second_neighbour_distance(EVEN), wanted, rtol=1e-13, atol=0)
    assert second_neighbour_distance(EVEN[:1]) == [0.0]


def test_a_post_costs_no_more_than_ground() -> None:
    """Groups along a curve over the plane are as high as the post: boxes that hold a place tell
    little, and a search that took all that is as near as these are high would look at every point.
    """
    rng = np.random.default_rng(3)
    post = rng.uniform(0, [0.01, 0.01, 100.0], (4000, 3))
    post = post[hilbert_order(post[:, :2])]
    index, best, stack = nearest_index(post), np.empty(3), np.empty(128, np.int64)
    for place in post[::400]:
        square = np.sort(((post - place) ** 2).sum(axis=1))[:3]
        last = kth_square(index, place, best, stack)
        assert last == best[-1] and np.allclose(best, square, rtol=1e-13, atol=0)
        rows, near = np.empty(64, np.int64), np.empty(64)
        assert collect(index, place, last, rows, near, stack) == 3

"""Equal rows by hashing, against sorting."""

import numpy as np
import pytest

from ladar_volume.math.equal_rows import distinct_cells, distinct_rows, few_values, first_equal

RNG = np.random.default_rng(3)
ROWS = {
    "few values": RNG.integers(-3, 3, (5000, 3)) * 1.0,
    "zeros of both signs": RNG.integers(0, 2, (40, 2)) * -0.0,
    "none": np.zeros((0, 3)),
    "one": np.ones((1, 2)),
    "all alike": np.full((900, 3), 1e300),
    "millimetres": RNG.uniform(4e5, 4e5 + 3, (20_000, 2)).round(2),
    "powers of two": 2.0 ** RNG.integers(-300, 300, (3000, 1)) * [1.0, 0.0],
}


@pytest.mark.parametrize("name", ROWS)
def test_first_of_equal_rows(name: str) -> None:
    values = ROWS[name]
    _, first, number = np.unique(values + 0.0, axis=0, return_index=True, return_inverse=True)
    assert np.array_equal(first_equal(values), first[number.reshape(-1)])
    assert np.array_equal(distinct_rows(values), np.sort(first))


def test_nan_equals_nothing() -> None:
    values = np.array([[np.nan, 1.0], [np.nan, 1.0], [2.0, 1.0], [2.0, 1.0]])
    assert first_equal(values).tolist() == [0, 1, 2, 2]


@pytest.mark.parametrize("most", [3, 1 << 20, 1 << 40])
@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_distinct_cells_are_those_of_numpy(most: int, dtype: type) -> None:
    rng = np.random.default_rng(most)
    cell = rng.integers(-min(most, 1 << 30), most, (500, 3)).astype(dtype)[
        rng.integers(500, size=900)
    ]
    first, number = distinct_cells(cell)
    want = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    assert np.array_equal(first, want[1]) and np.array_equal(number, want[2].ravel())


def test_of_no_cells_none_is_distinct() -> None:
    first, number = distinct_cells(np.zeros((0, 2), np.int64))
    assert not len(first) and not len(number)


@pytest.mark.parametrize("count", [0, 1, 5, 64, 65, 300])
def test_few_values_are_those_that_sorting_finds(count: int) -> None:
    some = RNG.permutation(np.linspace(-2.0, 7.0, count))
    values = RNG.choice(np.r_[some, np.nan, np.inf, -np.inf], 5000)
    values[: 2 * count] = np.repeat(some, 2)
    assert few_values(values) == np.unique(values[np.isfinite(values)]).tolist()
    assert few_values(values[:0]) == []


def test_rows_are_compared_with_the_first_so_many_alone() -> None:
    values = ROWS["few values"]
    found = first_equal(values, 20)
    for row in range(len(values)):
        same = np.flatnonzero((values[:20] == values[row]).all(axis=1))
        assert found[row] == (same[0] if len(same) else row)

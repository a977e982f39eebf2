"""The decorators of compiled kernels."""

import sys
import weakref

import numba
import numpy as np
import pytest

from ladar_volume.math.kernels import kernel, leaf_kernel, run_in_ranges, run_in_threads


@leaf_kernel
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf_kernel
def trace(x, y):
    total = 0.0
    for i in range(len(x)):
        total += dot(x[i], y[i])
    return total


@kernel
def traces(x, rounds):
    total = 0.0
    for _ in range(rounds):
        work = x.copy()  # owned here, lent to the leaf
        total += trace(x, work)
    return total


def test_a_leaf_is_its_plain_twin_and_leaves_its_arrays_alone():
    x = np.random.default_rng(3).normal(size=(200, 3))
    held = sys.getrefcount(x)
    assert traces(x, 50) == pytest.approx(50.0 * np.sum(x * x), rel=1e-12)
    assert traces(x[::2], 2) == pytest.approx(2.0 * np.sum(x[::2] ** 2), rel=1e-12)
    assert sys.getrefcount(x) == held
    gone = weakref.ref(x)
    del x
    assert gone() is None, "a reference was kept"


def test_a_leaf_that_allocates_is_refused():
    @numba.njit(_nrt=False)
    def allocates(n):
        return np.empty(n)[0]

    with pytest.raises(numba.core.errors.NumbaError, match="empty"):
        allocates(3)


@kernel
def counted(which, times):
    for i in which:
        times[i] += 1


@pytest.mark.parametrize("count", [0, 1, 7, 100, 1000])
def test_threads_get_every_index_once(count):
    times = np.zeros(3 + count, np.int64)
    run_in_threads(counted, np.arange(3, 3 + count), times)
    assert times.tolist() == [0, 0, 0] + [1] * count


@kernel
def counted_range(first, end, times):
    for i in range(first, end):
        times[i] += 1


@pytest.mark.parametrize("count", [0, 1, 7, 999, 1000, 1001, 5432])
def test_ranges_hold_every_element_once(count, monkeypatch):
    monkeypatch.setattr("ladar_volume.math.kernels.MANY", 1000)
    times = np.zeros(count, np.int64)
    run_in_ranges(counted_range, count, times)
    assert (times == 1).all()


def test_what_a_part_raises_is_raised():
    with pytest.raises(IndexError):
        run_in_threads(lambda which, times: times[which[-1]], np.array([0, 5]), np.zeros(2))

"""Sums of heights whose errors are correlated, against the double sum."""

import numpy as np
import pytest

from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.piles import HeightError
from ladar_volume.uncertainty.shared_heights import shared_variances


@pytest.mark.parametrize("length", [0.05, 1.0, 10.0, 1e3])
def test_the_grid_gives_the_double_sum_over_all_pairs(length):
    rng = np.random.default_rng(int(length))
    xy = rng.uniform(-3.0, 17.0, (600, 2)) + np.array([433000.0, 5100000.0])
    g = np.column_stack([rng.uniform(0, 1, 600), rng.normal(0, 1, 600), np.sin(xy[:, 0])])
    d = np.hypot(*(xy[:, None] - xy[None]).transpose(2, 0, 1))
    pairs = np.exp(-d / length)
    want = 0.03**2 * np.einsum("ik,ij,jk->k", g, pairs, g)
    assert shared_variances(xy, g, HeightError("a", 0.03, length)) == pytest.approx(want, rel=2e-3)


def test_what_all_share_is_the_square_of_the_sum():
    xy, g = np.zeros((4, 2)), np.arange(8.0).reshape(4, 2)
    assert shared_variances(xy, g, HeightError("a", 0.5)) == pytest.approx([36.0, 64.0])
    # at one place the correlation is 1 whatever its length
    assert shared_variances(xy, g, HeightError("a", 0.5, 2.0)) == pytest.approx([36.0, 64.0])


def test_a_length_below_what_the_grid_holds_is_refused():
    xy = np.array([[0.0, 0.0], [1000.0, 0.0]])
    with pytest.raises(ConfigurationError, match="too short"):
        shared_variances(xy, np.ones((2, 1)), HeightError("a", 1.0, 0.01))


@pytest.mark.parametrize(
    "values", [(-1.0, 3.0), (1e200, 3.0), (np.nan, 3.0), (0.1, 0.0), (0.1, np.nan)]
)
def test_errors_that_are_none_are_refused(values):
    with pytest.raises(ConfigurationError):
        HeightError("a", *values)

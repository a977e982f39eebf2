"""A cone with noise, as points."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def cone_points():
    rng = np.random.default_rng(5)
    xy = rng.uniform(-8, 8, (4000, 2))
    return np.c_[xy, np.maximum(0, 3 - np.hypot(*xy.T)) + 0.01 * rng.normal(size=len(xy))]

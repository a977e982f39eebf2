"""The two epochs of the benchmark: their exact volume, their density, and what the measurement
returns.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from benchmarks import epochs


def test_the_pile_has_its_volume_and_the_density_its_range():
    h, R = epochs.HEIGHT_M, epochs.RADIUS_M
    volume, _ = quad(lambda r: 2 * np.pi * r * 0.5 * h * (1 + np.cos(np.pi * r / R)), 0, R)
    assert volume == pytest.approx(epochs.VOLUME_M3, rel=1e-9) and epochs.HALF_M > R
    xy = epochs.places(200_000, np.random.default_rng(0))
    assert xy.shape == (200_000, 2) and np.abs(xy).max() <= epochs.HALF_M
    counts = np.histogram2d(xy[:, 0], np.cos(2 * np.pi * xy[:, 1] / 9.0), bins=[8, 2])[0]
    assert counts.max() / counts.min() > 5


def test_a_small_run_is_within_its_own_sigma():
    out = epochs.run((4000,), 4)
    assert abs(out["4,000 points: bias / %"]) < 4 * out["4,000 points: predicted sigma / %"] / 2
    a, b = epochs.surveys(1001, 3)
    assert len(a) + len(b) == 1001 and np.array_equal(a, epochs.surveys(1001, 3)[0])

"""Noise by least trimmed squares against its plain twin, and of points that lie on a line."""

from __future__ import annotations

import numpy as np
import pytest
import trimmed_twin
from scipy.spatial import cKDTree

from ladar_volume.clouds.sampling.trimmed_noise import trimmed_noise


@pytest.mark.parametrize("bend", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("away", [0.0, 1e6])
def test_the_noise_is_that_of_the_twin(bend: float, away: float) -> None:
    rng = np.random.default_rng(1)
    r = rng.normal(size=(2000, 3)) * [3.0, 3.0, 0.01]
    r[:, 2] += bend * r[:, 0] ** 2 + (rng.random(2000) < 0.1) * rng.normal(size=2000) * 0.3
    near = cKDTree(r).query(r[:400], k=60)[1]
    near[::3, 50:] = -1
    r += away
    want = trimmed_twin.trimmed_noise(r, near)
    np.testing.assert_allclose(trimmed_noise(r, near), want, rtol=1e-9)


def test_points_on_a_line_have_the_noise_across_it() -> None:
    rng = np.random.default_rng(2)
    r = np.zeros((60, 3))
    r[:, 0], r[:, 2] = np.linspace(0.0, 10.0, 60), rng.normal(0.0, 0.01, 60)
    found = trimmed_noise(r, np.arange(60)[None])[0]
    assert found < 0.013


def test_points_in_one_place_tell_no_noise() -> None:
    assert np.isnan(trimmed_noise(np.ones((30, 3)), np.arange(30)[None])[0])

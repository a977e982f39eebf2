"""The field of the ground counts as far as the data speak for it, without a limit at which rounding
would choose between none and all; so does what null volumes make of its line.
"""

import numpy as np
import pytest

from ladar_volume.uncertainty.roughness import counting_share, field_from_products
from ladar_volume.volume.field_checks.null_volumes import NullVolumes

NOISE = 4e-4
LAG = np.concatenate([[0.0, 0.05], np.geomspace(0.12, 6.0, 23)])
PAIRS = np.concatenate([[1000.0], np.geomspace(300.0, 40000.0, 24)])
VARIANCE = NOISE**2 / PAIRS + np.append((0.5 * NOISE) ** 2, np.zeros(24))


def line(first: float, field: float) -> float:
    """What a large body feels of the field, s² L², for a mean square that exceeds the
    noise by ``first`` of it and products of a field of so much of it.
    """
    value = field * NOISE * np.exp(-LAG / 0.3)
    value[0] = first * NOISE
    found = field_from_products(LAG, value, VARIANCE, 0.2, 12.0)
    return found.variance_m2 * found.length_m**2


@pytest.mark.parametrize("field", [0.02, 0.04, 0.06])
def test_no_jump_where_the_mean_square_passes_the_noise(field: float) -> None:
    lines = np.array([line(first, field) for first in np.linspace(-0.1, 0.1, 401)])
    assert np.abs(np.diff(lines)).max() < 0.05 * lines.max()
    close = [line(first, field) for first in (-1e-12, 0.0, 1e-12)]
    assert np.ptp(close) < 1e-6 * lines.max()


@pytest.mark.parametrize("first", [-0.03, 0.0, 0.03])
def test_no_jump_where_a_field_becomes_significant(first: float) -> None:
    lines = np.array([line(first, field) for field in np.linspace(0.0, 0.15, 401)])
    assert np.abs(np.diff(lines)).max() < 0.05 * lines.max()
    assert lines[0] < 1e-3 * lines.max() and (np.diff(lines) > -1e-3 * lines.max()).all()


def test_none_and_all_are_still_there() -> None:
    assert line(-0.3, 0.0) == 0.0
    assert counting_share(-1.0, 1.9) == 0.0 and counting_share(-1.0, 6.0) == 1.0
    assert counting_share(1.0, 0.5) == 1.0 and counting_share(1.0, 0.0) == 0.0
    whole = line(0.5, 0.5)
    assert whole == pytest.approx(0.09 * 0.5 * NOISE, rel=0.3)


def test_null_volumes_widen_the_line_without_a_jump() -> None:
    sigma = np.full(8, 0.01)
    scales = np.array([NullVolumes(f * sigma, sigma, 1.0).scale for f in np.linspace(0.5, 2, 601)])
    assert (np.diff(scales) >= 0.0).all() and np.diff(scales).max() < 0.03
    assert scales[0] == 1.0
    strong = NullVolumes(2.0 * sigma, sigma, 1.0)
    assert strong.scale == pytest.approx(strong.factor) == pytest.approx(4.0)

"""What the chords of a curved surface add below the base belongs to the fill, with its sign."""

import numpy as np
import pytest
from volume_surfaces import platform, surface_update

from ladar_volume.model.parameters import Parameters
from ladar_volume.volume.estimator import VolumeEstimator

BEND, DEPTH = 0.03, 9.0
#: Half side of the square that the outermost points span, m.
HALF = 5.75


@pytest.mark.parametrize("up", (1.0, -1.0))
def test_a_bowl_and_a_dome_hold_what_their_integral_says(up):
    base = {"base": "level", "level_m": 0.0, "outline": "all"}
    e = VolumeEstimator(Parameters.read({"filter": {"nav_bin_s": 1.0}, "volume": base}))
    e.add_platform(platform())
    e.add(surface_update(lambda x, y: up * (DEPTH - BEND * (x**2 + y**2)), half=6.0))
    v = e.estimate().volume
    exact = 4.0 * HALF**2 * DEPTH - BEND * 8.0 * HALF**4 / 3.0
    # chords over steps of half a metre lie inside by BEND step² / 6 along each axis
    chords = BEND * 0.5**2 / 3.0 * 4.0 * HALF**2
    cut, fill = (exact, 0.0) if up > 0.0 else (0.0, exact)
    assert abs(v.chord_m3) > 0.5 * chords
    assert (v.cut_m3, v.fill_m3) == pytest.approx((cut, fill), abs=0.5 * abs(v.chord_m3))
    assert v.volume_m3 == pytest.approx(v.cut_m3 - v.fill_m3, abs=1e-9)
    assert np.sign(v.chord_m3) == -up

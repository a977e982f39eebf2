"""The page for surveyors: its arithmetic, and the program's own budget for the heap worked by
hand.
"""

from __future__ import annotations

import doctest
import math
from pathlib import Path

import numpy as np
import pytest
from volume_surfaces import BIN_NS, T0, normal_frame

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import FilteredPoints, FilterUpdate, Patches, PlatformStates
from ladar_volume.volume.estimator import VolumeEstimator

PAGE = Path(__file__).parents[2] / "docs" / "uncertainty.md"


def test_every_line_of_the_page():
    found = doctest.testfile(str(PAGE), module_relative=False)
    assert found.attempted >= 20 and found.failed == 0


def heap():
    """400 patches of one return each on a top of 10 m by 10 m, 22 m below a lane 6 m aside, seen
    from abeam within 20 s.
    """
    grid = np.arange(20) * 10.0 / 19.0 - 5.0
    x, y = (a.ravel() for a in np.meshgrid(grid, grid, indexing="ij"))
    r, n = np.stack([x, y, np.full(400, 2.0)], axis=1), np.tile([0.0, 0.0, 1.0], (400, 1))
    v = r - np.stack([x, np.full(400, 6.0), np.full(400, 24.0)], axis=1)
    M_cal, M_nav = (
        np.zeros((400, 5, 13), np.float32),
        np.zeros((400, 5, 4), np.float32),
    )  # the page knows heights alone
    M_cal[:, 0, 0] = -1.0  # the page takes the beam as vertical
    M_cal[:, 0, 1:4] = M_nav[:, 0, 1:] = np.cross(v, n)
    M_nav[:, 0, 0] = 1.0
    t = T0 + np.floor((x + 5.0) / 10.0 * 19.999 / 2.0).astype(np.int64) * 2 * BIN_NS
    key, start = np.arange(400, dtype=np.int64), np.arange(401)
    C = np.zeros((400, 3, 3))
    C[:, 0, 0] = 0.010**2
    patches = Patches(
        key,
        r,
        n,
        normal_frame(n)[0],
        np.zeros((400, 3)),
        np.ones(400),
        np.full(400, 9, np.int32),
        t,
        start,
        key,
        C,
        M_cal,
        start,
        t // (2 * BIN_NS),
        M_nav,
    )
    points = FilteredPoints(
        r, n, C[:, 0, 0], np.zeros((400, 6), np.float32), t, key, np.zeros((400, 2))
    )
    return FilterUpdate(T0, np.zeros(0, np.int64), points, patches)


def test_the_program_agrees_with_the_hand():
    budget = {
        "boresight_sigma_deg": [0.02, 0.0, 0.0],
        "attitude_sigma_deg": [0.0, 0.0, 0.0],
        "position_sigma_m": [0.0, 0.0, 0.021],
    }
    parameters = Parameters.read(
        {
            "budget": budget,
            "filter": {"nav_bin_s": 2.0},
            "georeference": {"beams": 1, "max_position_gap_s": 0.1},
            "volume": {"base": "level", "outline": "all"},
        }
    )
    e = VolumeEstimator(parameters)
    t = T0 + np.arange(200) * (BIN_NS // 10)
    C = np.zeros((200, 6, 6))
    C[:, 2, 2] = 0.021**2
    p = np.stack([np.linspace(-5.0, 5.0, 200), np.full(200, 6.0), np.full(200, 24.0)], axis=1)
    q = np.tile([0.0, 0.0, 0.0, 1.0], (200, 1))
    e.add_platform(
        PlatformStates(t, p, q, np.zeros((200, 3)), np.zeros((200, 3)), C, np.zeros(200, np.int64))
    )
    e.add(heap())
    v = e.estimate().volume
    assert (v.volume_m3, v.area_m2) == pytest.approx((200.0, 100.0))
    sigma = {source: math.sqrt(line) for source, line in v.budget_m6.items()}
    assert sigma["range_bias"] == pytest.approx(0.300, rel=1e-9)
    assert sigma["boresight"] == pytest.approx(0.209, abs=0.001)
    # points at the rim stand for half as much area as those inside, and bins of 2 s for moments:
    # some per cent
    assert sigma["noise"] == pytest.approx(0.050, rel=0.06)
    assert sigma["position"] == pytest.approx(1.976, rel=0.005)
    assert v.largest_source == "position" and v.sigma_if_halved_m3["position"] == pytest.approx(
        1.05, abs=0.01
    )

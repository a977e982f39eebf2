"""Kern's procedure on one page: regions, noise along the beam, what depends on closed parts,
resolution, refusals.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.pits import PITS, pit, rim
from ladar_volume.change.excavation import (
    Region,
    Scan,
    beam_noise,
    by_resolution,
    excavate,
    hull_polygon,
    region_of,
    select,
)
from ladar_volume.model.errors import VolumeError

OPENING, FLOOR, DEPTH, SCANNER = PITS["frustum"]
EYE = np.array(SCANNER) + np.array([0.0, 0.0, 1.5])


@pytest.fixture(scope="module")
def scans():
    before, after, truth = pit(OPENING, FLOOR, DEPTH, 0.2)
    return Scan(before, EYE, 0.01), Scan(after, EYE, 0.01), truth


def test_noise_along_the_beam_counts_less_on_faces_seen_aslant(scans):
    a, b, _ = scans
    region = Region(rim(OPENING, 0.4), 0.5, 0.3)
    along = [Scan(s.points, EYE, beam_noise(s.points, EYE, 0.01)) for s in (a, b)]
    C = np.asarray(along[0].noise)
    beam = a.points - EYE
    assert np.trace(C, axis1=1, axis2=2) == pytest.approx(1e-4)
    assert np.einsum("nij,nj->ni", C, beam) == pytest.approx(1e-4 * beam)
    every, only = excavate(a, b, region), excavate(*along, region)
    assert only.removed_m3 == pytest.approx(every.removed_m3, rel=1e-6)
    assert 0.2 * every.sigma_m3 < only.sigma_m3 < every.sigma_m3
    assert (
        along[0].sigma() == pytest.approx(0.01) == a.sigma()
        and Scan(a.points, EYE, np.nan).sigma() == 0.0
    )


def test_what_hangs_on_closed_parts_is_said(scans):
    a, b, truth = scans
    region = Region(rim(OPENING, 0.4), 0.5, 0.2)
    whole = excavate(a, b, region, max_edge_m=0.8)
    hole = (np.abs(a.points[:, 0] - 2.5) < 0.5) & (np.abs(a.points[:, 1] - 2.0) < 0.5)
    part = excavate(a.part(~hole), b, region, max_edge_m=0.8)
    assert whole.closed_m3 < 1e-9 and whole.removed_m3 == pytest.approx(truth, rel=1e-4)
    # at most the square of 1.2 m, a third of its area times the height above the body's middle; its
    # corners close with short edges
    square = 1.2**2 * 0.5 * DEPTH / 3.0
    assert 0.3 * square < part.closed_m3 <= 1.001 * square and part.removed_m3 == pytest.approx(
        truth, rel=1e-3
    )


def test_regions_fill_in_what_is_not_given(scans):
    a, b, _ = scans
    region = region_of(a.points)
    assert region.margin_m == pytest.approx(0.6) and np.ptp(
        hull_polygon(a.points), axis=0
    ) == pytest.approx([7.0, 6.0])
    size = np.ptp(region.corners, axis=0)
    assert size == pytest.approx([7.0 - 1.2, 6.0 - 1.2]) and 0.1 < region.spacing_m < 0.6
    shifted = region_of(a.points + np.array([4e5, 5.6e6, 0.0]))
    assert shifted.corners - [4e5, 5.6e6] == pytest.approx(region.corners, abs=1e-6)
    in_a, in_b = select(a, b, region)
    out = np.abs(a.points[~in_a, :2] - [2.5, 2.0])
    assert (
        out > [2.9, 2.4]
    ).all() and in_b.all()  # the margin goes round the corners, which alone are left out
    in_a, _ = select(a, b, region, 0.0)
    assert not in_a.all() and np.abs(a.points[in_a, 0] - 2.5).max() <= 2.9 + 1e-9


def test_resolution_thins_both_scans(scans):
    a, b, truth = scans
    s = by_resolution(a, b, Region(rim(OPENING, 0.4), 0.6, 0.2), [0.5, 0.05, 0.25])
    assert (
        s.cell_m.tolist() == [0.05, 0.25, 0.5]
        and len(b.points) >= s.points[0] > s.points[1] > s.points[2]
    )
    assert s.volume_m3[0] == pytest.approx(truth, rel=1e-4) and s.volume_m3 == pytest.approx(
        truth, rel=0.1
    )
    assert 1.9 < s.dimension < 2.2


def reason(call):
    with pytest.raises(VolumeError) as caught:
        call()
    return caught.value.reason


def test_refusals(scans):
    a, b, _ = scans
    good = Region(rim(OPENING, 0.4), 0.5, 0.3)
    assert reason(lambda: hull_polygon(a.points, 30.0)) == "region_hull"
    assert (
        reason(lambda: hull_polygon(np.array([[0.0, 0, 0], [1, 1, 0], [2, 2, 0]]))) == "region_hull"
    )
    assert reason(lambda: hull_polygon(np.zeros((0, 3)))) == "region_hull"
    assert reason(lambda: region_of(a.points, np.zeros((0, 2)))) == "region_polygon"
    assert reason(lambda: region_of(a.points, np.full((4, 2), np.nan))) == "region_polygon"
    assert reason(lambda: region_of(a.points, margin_m=np.nan)) == "region_margin"
    assert (
        reason(lambda: region_of(a.points, np.array([[0.0, 0], [1, 1], [1, 0], [0, 1]])))
        == "volume_polygon"
    )
    assert (
        reason(lambda: excavate(a, b, good, pole_map=np.array([0.0, np.nan, 1.0]))) == "volume_pole"
    )
    assert reason(lambda: excavate(a, Scan(b.points + 100.0, EYE, 0.01), good)) == "region_empty"
    # a scanner below the ground sees the ring from its other side
    below = Scan(b.points, np.array([2.5, 2.0, -9.0]), 0.01)
    assert reason(lambda: excavate(a, below, good)) in ("ring_sides", "ring_touches", "ring_lost")

"""The pixels of a map: each shows the triangle that counts at its middle."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path

from ladar_volume.model.errors import SurfaceError
from ladar_volume.report import scene as scenes
from ladar_volume.report.scene import Scene
from ladar_volume.tin.full_tin import build_tin


def scene_of(xy, counted):
    tin = build_tin(np.column_stack([xy, np.zeros(len(xy))]))
    counted = np.broadcast_to(counted, len(tin.triangles)) & True
    return Scene(tin, counted, np.zeros(len(xy)), None, [], lambda at: np.zeros(len(at)), "", "")


@pytest.mark.parametrize("wide", [1.0, 4.0])
def test_a_pixel_shows_the_triangle_at_its_middle(wide, monkeypatch):
    monkeypatch.setattr(scenes, "PIXELS", 40)
    rng = np.random.default_rng(4)
    xy = rng.uniform(0.0, 1.0, (60, 2)) * (wide, 1.0) + (4e5, 5e6)
    count = len(build_tin(np.column_stack([xy, np.zeros(60)])).triangles)
    scene = scene_of(xy, rng.random(count) < 0.7)
    pixels = scene.pixels
    west, east, south, north = pixels.extent
    h, w = pixels.at.shape
    assert max(h, w) == 40 and (east - west) / w == pytest.approx((north - south) / h)
    x = west + (np.arange(w) + 0.5) * (east - west) / w
    y = south + (np.arange(h) + 0.5) * (north - south) / h
    middles = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    off = scene.corners()[0, 0, :2]
    for number, corners in enumerate(scene.corners()):
        held = Path(corners[:, :2] - off).contains_points(middles - off)
        assert np.array_equal(held, (pixels.at == number).ravel())


def test_where_no_triangle_counts_there_is_no_map():
    with pytest.raises(SurfaceError):
        scene_of(np.random.default_rng(5).random((9, 2)), False).pixels  # noqa: B018

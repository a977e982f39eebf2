"""The pixels of a map: each shows the triangle that counts at its middle."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.path import Path

from ladar_volume.model.errors import SurfaceError
from ladar_volume.report import scene as scenes
from ladar_volume.report.scene import Residuals, Scene, coarser, sections_of
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.locate import height_at, locate, triangle_index


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


def test_of_many_triangles_those_at_pixels_are_drawn(monkeypatch):
    monkeypatch.setattr(scenes, "PIXELS", 12)
    rng = np.random.default_rng(8)
    xy = rng.uniform(0.0, 1.0, (400, 2))
    count = len(build_tin(np.column_stack([xy, np.zeros(400)])).triangles)
    every, fewer = (scene_of(xy, rng.random(count) < 2.0) for _ in range(2))
    whole = every.pixels
    monkeypatch.setattr(scenes, "MOST_DRAWN", 399)
    some = fewer.pixels
    assert len(whole.drawn) == count > 400 > len(some.drawn) > 50
    assert np.array_equal(whole.shown, some.shown)
    shown = whole.shown
    assert np.array_equal(whole.drawn[whole.at[shown]], some.drawn[some.at[shown]])
    value = rng.random(400)
    colours = every.of_triangles(value)[whole.at[shown]], fewer.of_triangles(value)[some.at[shown]]
    assert np.array_equal(*colours)


@pytest.mark.parametrize("kind", ["scattered", "grid", "fan"])
def test_pixels_are_those_of_a_search(kind, monkeypatch):
    """Middles of pixels lie on sides and corners of the grid's triangles; a fan's are long."""
    monkeypatch.setattr(scenes, "PIXELS", 16)
    rng = np.random.default_rng(9)
    grid = np.stack(np.meshgrid(np.arange(17.0), np.arange(9.0)), axis=-1).reshape(-1, 2) / 2.0
    turn = np.linspace(0.1, 1.4, 200)
    fan = np.vstack([[0.0, 0.0], 9.0 * np.column_stack([np.cos(turn), np.sin(turn)])])
    xy = {"scattered": rng.uniform(-3.0, 7.0, (300, 2)), "grid": grid, "fan": fan}[kind]
    scene = scene_of(xy, True)
    pixels, index = scene.pixels, triangle_index(scene.tin, scene.counted)
    west, east, south, north = pixels.extent
    h, w = pixels.at.shape
    x, y = west + (np.arange(w) + 0.5) * (east - west) / w, np.arange(h) + 0.5
    middles = np.stack(np.meshgrid(x, south + y * (north - south) / h), axis=-1).reshape(-1, 2)
    assert np.array_equal(pixels.at.ravel(), locate(index, middles))


def test_a_section_shows_the_surface_under_it():
    rng = np.random.default_rng(10)
    tin = build_tin(rng.uniform(0.0, 20.0, (500, 3)))
    none = np.zeros(len(tin.vertices))
    outline = np.array([[4.0, 6.0], [15.0, 6.0], [12.0, 17.0]])
    scene = Scene(tin, tin.relevant, none, None, [outline], lambda at: np.zeros(len(at)), "", "")
    for section in sections_of(scene):
        xy = np.linspace(*section.ends, scenes.PLACES)
        surface = height_at(tin, xy)
        assert section.surface_m == pytest.approx(surface, rel=1e-9, nan_ok=True)
        assert np.isfinite(surface).mean() > 0.9


def test_many_places_of_passes_become_fewer(monkeypatch):
    monkeypatch.setattr(scenes, "MOST_PLACES", 30)
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    xy, apart = np.column_stack([x.ravel(), y.ravel()]), np.where(x.ravel() < 10, 3.0, 4.0)
    found = coarser(Residuals(xy, apart, 1.0))
    assert found.edge_m == 4.0 and len(found.xy_m) == 25
    middle = (found.xy_m[:, 0] > 8.0) & (found.xy_m[:, 0] < 12.0)
    assert found.apart_m[middle] == pytest.approx(np.sqrt((9.0 + 16.0) / 2.0))
    assert set(found.apart_m[~middle].round(12)) == {3.0, 4.0}
    few = Residuals(xy[:30], apart[:30], 1.0)
    assert coarser(few) is few


def test_where_no_triangle_counts_there_is_no_map():
    with pytest.raises(SurfaceError):
        scene_of(np.random.default_rng(5).random((9, 2)), False).pixels  # noqa: B018

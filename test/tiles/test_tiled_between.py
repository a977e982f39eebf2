"""What lies between the points, by tiles against one process."""

import dataclasses

import numpy as np
import pytest
from tiled_clouds import LEVEL, SIGMA, at_once, gridded, on_lines, random, write

from ladar_volume.clouds import between_points as whole
from ladar_volume.clouds.volume_verdict import counted_areas
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.tiles.tiled_volume import VolumeTask, volume_by_tiles


def ragged(n, rng):
    """Two densities, a hole, and a copy or two."""
    xy = np.concatenate([rng.random((n, 2)) * [70, 45], rng.random((n // 3, 2)) * [20, 45]])
    xy = xy[np.hypot(xy[:, 0] - 45, xy[:, 1] - 25) > 6.0]
    return np.concatenate([xy, xy[:40]])


def both(path, folder, tile_m):
    surface, _ = at_once(path)
    tin = surface.representation.tin
    one = whole.between_points(surface, counted_areas(surface, tin.relevant), tin.vertices[:, 2])
    volume = VolumeParameters(base="level", level_m=LEVEL, outline="all")
    cloud = parts_of_file(path, folder, tile_m, Reading(), 3000)
    task = VolumeTask(Limits(), Parameters(volume=volume), SIGMA)
    return one, volume_by_tiles(cloud, task, OwnProcess())


@pytest.mark.parametrize(
    ("kind", "tile_m", "rel"),
    [
        (random, 21.0, 1e-9),
        (gridded, 27.0, 1e-9),
        (on_lines, 1000.0, 1e-9),  # middles of triangles lie on edges of the coarser surface
        (ragged, 27.0, 1e-9),
    ],
)
def test_tiles_tell_what_lies_between_the_points(tmp_path, kind, tile_m, rel):
    path = write(tmp_path / "cloud.laz", kind(3000, np.random.default_rng(5)))
    one, found = both(path, tmp_path / "store", tile_m)
    assert dataclasses.astuple(found.between) == pytest.approx(dataclasses.astuple(one), rel=rel)
    assert one.random_m6 > 0.0
    assert found.volume.budget_m6["between_points"] == found.between.variance_m6

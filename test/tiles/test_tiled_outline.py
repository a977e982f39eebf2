"""Outline and ground that go on changing each other, by tiles."""

import pytest
from yards import bent_site, write_points

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import above_base
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.tiles.tiled_volume import VolumeTask, volume_by_tiles


def test_what_an_outline_that_does_not_settle_makes_is_that_of_one_process(tmp_path):
    moved = []
    for seed in range(4):
        path = write_points(tmp_path / f"{seed}.laz", bent_site(seed))
        options = SurfaceParameters(ratio=1.0, relevant="all")
        surface = cloud_surface(read_cloud(path).r, options, 0.02)
        base = above_base(surface, Parameters())[1]
        cloud = parts_of_file(path, tmp_path / "store", 19.0, Reading())
        task = VolumeTask(Limits(), Parameters(), 0.02, correct=False, between=False)
        found = volume_by_tiles(cloud, task, OwnProcess())
        assert found.base.unsettled_m3 == pytest.approx(base.unsettled_m3, rel=1e-8)
        moved.append(base.unsettled_m3)
    assert max(moved) > 1.0

"""How a file is dealt out into tiles."""

import laspy
import numpy as np
import pytest

from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.tiles import tile_store
from ladar_volume.tiles.tile_store import parts_of_file


def test_a_side_that_is_not_given_suits_the_points(tmp_path):
    rng = np.random.default_rng(3)
    xyz = np.column_stack([rng.uniform(0.0, 400.0, (200_000, 2)), rng.normal(0.0, 0.1, 200_000)])
    xyz[7] = [9e5, 9e5, 0.0]  # far away
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [1e-3] * 3, [0.0] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    las.write(tmp_path / "cloud.laz")
    cloud = parts_of_file(tmp_path / "cloud.laz", tmp_path / "s", None, Reading(), 60_000)
    each = 200_000 / 400.0**2 * cloud.tile_m**2
    assert each == pytest.approx(tile_store.EMPTY, rel=0.1)
    xyz[:, 1] = 3.0  # on one line
    las.y = xyz[:, 1]
    las.write(tmp_path / "line.laz")
    cloud = parts_of_file(tmp_path / "line.laz", tmp_path / "s", None, Reading(), 60_000)
    assert cloud.tile_m == tile_store.USUAL_M

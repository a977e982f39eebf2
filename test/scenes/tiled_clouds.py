"""Clouds as LAZ files, and their volume by tiles and at once."""

import dataclasses

import laspy
import numpy as np
import pytest

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import above_base
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.tiles.tiled_volume import VolumeTask, volume_by_tiles

SIGMA = 0.02
LEVEL = 10.5


def heights(x, y):
    return 10.0 + 3.0 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 150) + 0.3 * np.sin(x) * np.cos(y)


def random(n, rng):
    return rng.random((n, 2)) * [70, 45]


def gridded(n, rng):
    x, y = np.meshgrid(np.arange(0, 60, 0.75), np.arange(0, 42, 0.75))
    return np.column_stack([x.ravel(), y.ravel()])


def clustered(n, rng):
    middle = rng.random((12, 2)) * [70, 45]
    return middle[rng.integers(0, 12, n)] + rng.normal(0, [0.8, 0.3], (n, 2))


def on_lines(n, rng):
    t = rng.integers(0, 30, n)
    return np.column_stack([rng.random(n) * 70, 1.5 * t])


def write(path, xy, seed=1):
    rng = np.random.default_rng(seed)
    xy = xy + np.array([40.0, -20.0])
    z = heights(xy[:, 0] - 40, xy[:, 1] + 20) + rng.normal(0, SIGMA, len(xy))
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [1e-3] * 3, [0.0] * 3
    las = laspy.LasData(header)
    order = rng.permutation(len(xy))
    las.x, las.y, las.z = xy[order, 0], xy[order, 1], z[order]
    las.write(path)
    return path


def by_tiles(path, folder, tile_m, limits=None, workers=None, part=7000, **volume):
    """The volume by tiles above a level or a plane."""
    cloud = parts_of_file(path, folder, tile_m, Reading(), part)
    chosen = VolumeParameters(**({"base": "level", "level_m": LEVEL} | volume), outline="all")
    task = VolumeTask(limits or Limits(), Parameters(volume=chosen), SIGMA, between=False)
    return volume_by_tiles(cloud, task, workers or OwnProcess())


def at_once(path, option="all", limit=None, **volume):
    limits = {} if limit is None else {f"max_{option}_m".replace("circle", "circum"): limit}
    options = SurfaceParameters(ratio=1.0, relevant=option, **limits)
    surface = cloud_surface(read_cloud(path).r, options, SIGMA)
    chosen = VolumeParameters(**({"base": "level", "level_m": LEVEL} | volume), outline="all")
    return surface, above_base(surface, Parameters(volume=chosen))[0]


def same(a, b):
    for name, value in dataclasses.asdict(b).items():
        if isinstance(value, float | dict):
            assert getattr(a, name) == pytest.approx(value, rel=1e-9), name

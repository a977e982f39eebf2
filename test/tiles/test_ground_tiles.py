"""The volume above a ground of the same cloud, by tiles against one process."""

import dataclasses
import json
from types import SimpleNamespace

import laspy
import numpy as np
import pytest
from tiled_clouds import SIGMA, same

from ladar_volume.cli.main import main
from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.cloud_volume import above_base
from ladar_volume.ground import robust_ground
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.model.errors import GroundError, VolumeError
from ladar_volume.model.parameters import GroundParameters, Parameters, VolumeParameters
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tiles import tile_fit, tiled_ground
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tile_work import OwnProcess
from ladar_volume.tiles.tiled_ranks import rows_at_ranks
from ladar_volume.tiles.tiled_volume import VolumeTask, volume_by_tiles


def yard(path, n, seed, copies=0):
    """Two piles, one of them a ring with ground inside, on sloping uneven ground."""
    rng = np.random.default_rng(seed)
    xy = rng.random((n, 2)) * [80, 50] + [300.0, -25.0]
    xy[n - copies :] = xy[:copies]
    x, y = xy[:, 0] - 300, xy[:, 1] + 25
    z = 50 + 0.01 * x - 0.02 * y + 0.01 * np.sin(x / 4) * np.cos(y / 5)
    z += np.maximum(0, 4 - 0.6 * np.hypot(x - 25, y - 24))
    z += 2 * np.exp(-((np.hypot(x - 58, y - 26) - 9) ** 2) / 6)
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [1e-3] * 3, [0.0] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = xy[:, 0], xy[:, 1], z + rng.normal(0, SIGMA, n)
    las.write(path)
    return path


def both(
    path, folder, tile_m, limits=None, ground=None, part=1500, whole=True, correct=True, **volume
):
    limits = limits or Limits()
    p = Parameters(
        volume=VolumeParameters(base="ground", **volume), ground=GroundParameters(**(ground or {}))
    )
    cloud = parts_of_file(path, folder, tile_m, Reading(), part)
    found = volume_by_tiles(cloud, VolumeTask(limits, p, SIGMA, correct, False), OwnProcess())
    if not whole:
        return found
    options = SurfaceParameters(ratio=1.0, **dataclasses.asdict(limits))
    surface = cloud_surface(read_cloud(path).r, options, SIGMA)
    whole, base, _ = above_base(surface, p, correct)
    same(found.volume, whole)
    assert found.base.beta == pytest.approx(base.beta, rel=1e-9, abs=1e-12)
    return found


@pytest.mark.parametrize(
    ("tile_m", "more"),
    [
        (14.3, {}),
        (30.0, {"outline": "all", "ground": {"degree": 2}}),
        (1000.0, {"bodies": 0, "limits": Limits("edge", max_edge_m=1.5), "copies": 0}),
        (17.0, {"ground_ring_m": 0.0, "ground": {"threshold_m": 0.05}}),
        (30.0, {"correct": False}),
    ],
)
def test_tiles_give_the_ground_and_the_volume_of_one_process(tmp_path, tile_m, more):
    more = dict(more)
    path = yard(tmp_path / "yard.laz", 4000, 3, copies=more.pop("copies", 200))
    found = both(path, tmp_path / "store", tile_m, **more)
    assert found.volume.net_m3 > 100


def test_a_search_on_some_of_the_points_takes_the_same_ones(tmp_path, monkeypatch):
    for module in (robust_ground, tiled_ground):
        monkeypatch.setattr(module, "SEARCHED_POINTS", 150)
    path = yard(tmp_path / "yard.laz", 5000, 4)
    found = both(path, tmp_path / "store", 28.0)
    for damaged in (found.index.cloud.folder).glob("surface_*/*.arrays"):
        damaged.write_bytes(damaged.read_bytes()[:-500])
    assert both(path, tmp_path / "store", 28.0).volume == found.volume


@pytest.mark.parametrize(("first", "step"), [(1, 37), (7, 1), (7, 900), (300, 5), (1 << 16, 37)])
def test_ranks_are_told_block_by_block(monkeypatch, first, step):
    rows = np.random.default_rng(first).choice(5000, 900, replace=False)
    parts = dict(zip([(0, 0), (0, 1), (4, 4)], np.split(rows, [100, 100]), strict=True))
    monkeypatch.setattr(tile_fit, "chosen_of", lambda of, tile, chosen: (None, None, parts[tile]))
    cloud = SimpleNamespace(points=5000)
    of = SimpleNamespace(tiles=list(parts), index=SimpleNamespace(cloud=cloud))
    ranks = np.arange(0, 900, step)
    found = rows_at_ranks(OwnProcess(), of, None, ranks, first)
    assert (found == np.sort(rows)[ranks]).all()


def test_the_verb_volume_by_tiles(tmp_path, capsys):
    path = yard(tmp_path / "yard.laz", 2000, 5)
    words = ["volume", str(path), "--base", "ground", "--sigma", str(SIGMA), "--json"]
    plain = ["--clean", "off", "--relevant", "all"]
    assert main(words + plain) in (0, 3)
    whole = json.loads(capsys.readouterr().out)
    assert main([*words, *plain, "--tile", "25", "--store", str(tmp_path / "store")]) == 0
    tiled = json.loads(capsys.readouterr().out)
    assert tiled["base"] == whole["base"]
    assert whole["lengths"]["outline_margin_m"] > 1.0  # they follow the site
    assert tiled["lengths"] == pytest.approx(whole["lengths"], rel=1e-9)
    for name in ("cut_m3", "fill_m3", "net_m3", "area_m2"):
        assert tiled[name] == pytest.approx(whole[name], rel=1e-9)
    for line in ("noise", "base_surface", "between_points"):
        assert tiled["budget_m6"][line] == pytest.approx(whole["budget_m6"][line], rel=1e-9)
    assert main([*words, "--tile", "25", "--clean", "filter"]) == 2
    assert "--clean filter is not done by tiles" in capsys.readouterr().err
    assert main([*words, *plain, "--tile", "25", "--piles", "found"]) == 2
    assert "--piles is not done by tiles" in capsys.readouterr().err
    assert main([*words, *plain, "--workers", "2"]) == 2


def test_ground_that_no_tile_shows_is_refused_as_by_one_process(tmp_path):
    path = yard(tmp_path / "yard.laz", 2000, 6)
    with pytest.raises(VolumeError, match="nothing rises"):
        both(path, tmp_path / "a", 20.0, object_height_m=50.0, whole=False)
    with pytest.raises(GroundError, match="no surface holds"):
        both(path, tmp_path / "b", 20.0, ground={"min_support": 0.99}, whole=False)

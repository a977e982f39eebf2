"""The volume by tiles against that of one triangulation of all points."""

import shutil

import laspy
import numpy as np
import pytest
from tiled_clouds import (
    at_once,
    by_tiles,
    clustered,
    gridded,
    on_lines,
    random,
    same,
    write,
)

from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.model.errors import CloudError, ConfigurationError, InputError
from ladar_volume.tiles.array_file import read_arrays, write_arrays
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_patch import patch_of
from ladar_volume.tiles.tile_store import parts_of_file, tile_index
from ladar_volume.tiles.tile_surface import Limits, surface_of, surface_path, used_of
from ladar_volume.volume.neighbourhood import grow_kernel


@pytest.mark.parametrize("kind", [random, gridded, clustered, on_lines], ids=lambda k: k.__name__)
@pytest.mark.parametrize("tile_m", [13.7, 1000.0])
def test_tiles_give_what_one_triangulation_gives(tmp_path, kind, tile_m):
    path = write(tmp_path / "cloud.laz", kind(4000, np.random.default_rng(5)))
    surface, whole = at_once(path)
    found = by_tiles(path, tmp_path / "store", tile_m)
    same(found.volume, whole)
    assert whole.folded_m3 > 0.01 and whole.near_area_m2 > 10.0
    assert sum(s.triangles for s in found.sums) == len(surface.representation.tin.triangles)
    assert sum(s.vertices for s in found.sums) == len(surface.representation.tin.vertices)


def test_a_plane_and_a_longest_edge(tmp_path):
    path = write(tmp_path / "cloud.las", clustered(5000, np.random.default_rng(2)))
    _, whole = at_once(path, "edge", 1.5, base="plane", plane=(9.0, 0.02, 0.01))
    asked = {"limits": Limits("edge", max_edge_m=1.5), "base": "plane", "plane": (9.0, 0.02, 0.01)}
    same(by_tiles(path, tmp_path / "store", 11.0, **asked).volume, whole)


def test_the_own_vertices_of_a_surface_come_first_and_are_corners(tmp_path):
    path = write(tmp_path / "cloud.las", random(3_000, np.random.default_rng(8)))
    of = TiledCloud(by_tiles(path, tmp_path / "store", 20.0).index, Limits())
    for tile in of.tiles:
        s = surface_of(of.index, of.limits, tile)
        own = int(np.count_nonzero(s.own))
        assert s.own[:own].all() and np.array_equal(s.used, s.own)
        xyz, shared, row = used_of(of.index, of.limits, tile)
        assert np.array_equal(xyz, s.tin.vertices[s.used])
        assert np.array_equal(shared, s.shared[s.used]) and np.array_equal(row, s.row[s.used])


def test_the_surface_around_a_tile_is_that_of_all_points_and_no_larger_than_it_must_be(tmp_path):
    # the triangles on the hull are long, and led tiles there to join the whole survey
    path = write(tmp_path / "cloud.las", random(30_000, np.random.default_rng(3)))
    of = TiledCloud(by_tiles(path, tmp_path / "store", 8.0).index, Limits())
    whole = at_once(path)[0].representation.tin
    names = np.ascontiguousarray(whole.vertices[:, :2]).view(np.complex128).reshape(-1)
    for tile in (of.tiles[0], of.tiles[len(of.tiles) // 2], of.tiles[-1]):
        patch = patch_of(of, tile, surface_of(of.index, of.limits, tile), None, 6)
        xy = np.ascontiguousarray(patch.tin.vertices[:, :2])
        own = xy[patch.own].view(np.complex128).reshape(-1)
        expected, found = np.isin(names, own), np.zeros(len(xy), np.bool_)
        found[patch.own] = True
        grow_kernel(whole.triangles, expected, 6)
        grow_kernel(patch.tin.triangles, found, 6)
        near = np.unique(xy[found].view(np.complex128))
        assert np.array_equal(near, np.unique(names[expected]))
        assert len(xy) < len(names) // 8
    first = of.tiles[0]
    for tile in of.tiles[1:]:  # what lies at rest is that of another tile
        shutil.copy(surface_path(of.index, first), surface_path(of.index, tile))
    with pytest.raises(InputError, match="delete it and run again"):
        patch_of(of, first, surface_of(of.index, of.limits, first), None, 6)


def test_few_points_far_apart(tmp_path):
    xy = np.array([[0.0, 0], [40, 1], [3, 41], [44, 43], [44, 43.001], [20, 20]])
    path = write(tmp_path / "cloud.las", xy)
    _, whole = at_once(path)
    same(by_tiles(path, tmp_path / "store", 5.0).volume, whole)


def test_what_is_done_is_not_done_again_and_what_is_damaged_is_told(tmp_path):
    path = write(tmp_path / "cloud.laz", random(3000, np.random.default_rng(8)))
    found = by_tiles(path, tmp_path / "store", 20.0, part=1000)
    first, tiles = found.volume, sorted(found.index.count)
    gone, kept, *others = (surface_path(found.index, t) for t in tiles)
    gone.unlink()
    kept.write_bytes(kept.read_bytes()[:-500])
    done = [path.stat().st_mtime_ns for path in others]
    found.index.cloud.archive(1).unlink()
    assert by_tiles(path, tmp_path / "store", 20.0, part=1000).volume == first
    assert [path.stat().st_mtime_ns for path in others] == done
    archive = found.index.cloud.archive(2)
    good = archive.read_bytes()
    write_arrays(archive, read_arrays(archive) | {"notes": np.array("[1]")})
    with pytest.raises(InputError, match="damaged notes"):
        by_tiles(path, tmp_path / "store", 20.0, part=1000)
    archive.write_bytes(good[:-3000])
    assert by_tiles(path, tmp_path / "store", 20.0, part=1000).volume == first
    assert archive.read_bytes() == good


def test_another_file_of_the_same_name_has_tiles_of_its_own(tmp_path):
    path = write(tmp_path / "cloud.laz", random(800, np.random.default_rng(8)))
    one = parts_of_file(path, tmp_path, 20.0, Reading()).folder
    write(path, random(800, np.random.default_rng(9)))
    assert parts_of_file(path, tmp_path, 20.0, Reading()).folder != one
    assert parts_of_file(path, tmp_path, 21.0, Reading()).folder != one


def test_refusals(tmp_path):
    path = write(tmp_path / "cloud.las", np.array([[0.0, 0], [1, 1], [2, 2], [30, 30]]))
    with pytest.raises(Exception, match=r"tile -?\d+_-?\d+ .*collinear"):
        by_tiles(path, tmp_path / "store", 5.0)
    with pytest.raises(ConfigurationError, match="--tile 0"):
        parts_of_file(path, tmp_path, 0.0, Reading())
    with pytest.raises(InputError, match="LAS, LAZ and COPC"):
        parts_of_file(tmp_path / "cloud.xyz", tmp_path, 5.0, Reading())
    las = laspy.read(path)
    las.classification[:] = 7
    las.write(path)
    with pytest.raises(CloudError, match="none of 4 points counts"):
        by_tiles(path, tmp_path / "store", 5.0)


def test_points_that_do_not_count_are_counted(tmp_path):
    path = write(tmp_path / "cloud.las", random(500, np.random.default_rng(3)))
    las = laspy.read(path)
    las.classification[:300] = 7
    las.write(path)
    cloud = parts_of_file(path, tmp_path / "store", 20.0, Reading(), 100)
    by_tiles(path, tmp_path / "store", 20.0, part=100)
    index = tile_index(cloud)
    assert index.left_out == {"noise (class 7)": 300} and sum(index.count.values()) == 200

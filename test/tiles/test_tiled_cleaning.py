"""The strays of tiles against those of all points at once: the same points, in the same order."""

import pickle

import numpy as np
import pytest
from tiled_clouds import clustered, gridded, heights, on_lines, random
from whole_and_tiles import write

from ladar_volume.clouds.cloud_cleaning import clean, noise_along_curve
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.io.pointfiles.crs import Reading
from ladar_volume.math.equal_rows import distinct_rows, rows_of
from ladar_volume.tiles.array_file import at_rest
from ladar_volume.tiles.cleaning.near_box import EVERYWHERE, bounds, extents_of_tiles, near_box
from ladar_volume.tiles.cleaning.tiled_cleaning import Cleaner
from ladar_volume.tiles.tile_batches import TiledCloud
from ladar_volume.tiles.tile_store import distribute_part, parts_of_file, tile_index
from ladar_volume.tiles.tile_surface import EVERY
from ladar_volume.tiles.tile_work import OwnProcess

FAR = np.array([[500.0, 900.0, 30.0], [41.0, -19.0, -9999.0]])


def cloud_with_strays(kind, n, rng, strays, far):
    xy = kind(n, rng) + np.array([40.0, -20.0])
    z = heights(xy[:, 0] - 40, xy[:, 1] + 20) + rng.normal(0, 0.02, len(xy))
    some = rng.choice(len(xy), strays, replace=False)
    z[some] += rng.choice([-1, 1], strays) * rng.uniform(0.3, 6.0, strays)
    p = np.column_stack([xy, z])
    return np.vstack([p, p[:50], FAR] if far else [p, p[:50]])


def tiles_of(path, folder, tile_m):
    parts = parts_of_file(path, folder, tile_m, Reading(), 3000)
    for k in range(parts.count):
        distribute_part(parts, k)
    return TiledCloud(tile_index(parts), EVERY)


def cleaner(of):
    return Cleaner(of, OwnProcess(), lambda stage, done: None)


def distinct(path):
    cloud = read_cloud(path).r
    return rows_of(cloud, distinct_rows(cloud))


def in_order(index):
    points = np.concatenate([index.points(t) for t in sorted(index.count)])
    rank = np.concatenate([index.rows(t) for t in sorted(index.count)])
    assert len(np.unique(rank)) == len(rank)
    return points[np.argsort(rank)]


@pytest.mark.parametrize("far", [False, True], ids=["near", "far"])
@pytest.mark.parametrize("tile_m", [6.0, 21.0])
@pytest.mark.parametrize("kind", [random, gridded, clustered, on_lines], ids=lambda k: k.__name__)
def test_tiles_leave_out_what_the_whole_leaves_out(kind, tile_m, far, tmp_path):
    rng = np.random.default_rng(int(tile_m) + far)
    p = cloud_with_strays(kind, 3500, rng, 30, far)
    path = write(tmp_path / "cloud.laz", p, rng)
    points = distinct(path)
    whole = clean(points)
    found = cleaner(tiles_of(path, tmp_path / "store", tile_m)).cleaned()
    assert np.array_equal(in_order(found), points[whole.kept])
    assert found.strays == len(whole.strays) >= (2 if far else 0)
    assert found.isolated == whole.isolated_count
    assert found.noise == whole.noise
    assert len(whole.strays) > 3


def test_a_stray_far_from_its_tile_is_settled_by_the_nearest_tiles(tmp_path):
    rng = np.random.default_rng(8)
    p = cloud_with_strays(random, 4000, rng, 0, False)
    p = np.vstack([p, [[260.0, 10.0, 12.0], [261.0, 11.0, 12.0]]])  # 150 m from all others
    path = write(tmp_path / "cloud.laz", p, rng)
    points = distinct(path)
    whole, found = clean(points), cleaner(tiles_of(path, tmp_path / "store", 8.0)).cleaned()
    assert np.array_equal(in_order(found), points[whole.kept])


def test_few_points_are_left_as_they_are(tmp_path):
    rng = np.random.default_rng(9)
    path = write(tmp_path / "cloud.laz", cloud_with_strays(random, 60, rng, 0, False), rng)
    points = distinct(path)
    whole, found = clean(points), cleaner(tiles_of(path, tmp_path / "store", 20.0)).cleaned()
    assert np.array_equal(in_order(found), points[whole.kept])
    assert found.strays == 0 and found.noise == noise_along_curve(points)


def test_the_noise_of_all_points(tmp_path):
    rng = np.random.default_rng(10)
    path = write(tmp_path / "cloud.laz", cloud_with_strays(on_lines, 4000, rng, 9, False), rng)
    found = cleaner(tiles_of(path, tmp_path / "store", 20.0)).noise()
    assert found == noise_along_curve(distinct(path))


def test_what_is_at_rest_is_read_again_and_what_is_damaged_is_made_anew(tmp_path):
    rng = np.random.default_rng(11)
    path = write(tmp_path / "cloud.laz", cloud_with_strays(random, 3000, rng, 20, False), rng)
    of = tiles_of(path, tmp_path / "store", 20.0)
    first = cleaner(of).cleaned()
    points = in_order(first)
    assert not list(first.cloud.folder.glob("work*"))
    kept = at_rest(first.cloud.folder, "kept", sorted(first.count)[2])
    written = kept.stat().st_mtime_ns
    assert cleaner(of).cleaned().strays == first.strays and kept.stat().st_mtime_ns == written
    kept.write_bytes(kept.read_bytes()[:-9])
    again = cleaner(of).cleaned()
    assert np.array_equal(in_order(again), points) and again.noise == first.noise
    travelled = pickle.loads(pickle.dumps(again))
    assert travelled.count == again.count and travelled.stray_box == again.stray_box


def test_the_box_of_what_is_near_has_the_ends_of_the_whole(tmp_path):
    rng = np.random.default_rng(12)
    p = cloud_with_strays(random, 3000, rng, 0, True)
    path = write(tmp_path / "cloud.laz", p, rng)
    of = tiles_of(path, tmp_path / "store", 20.0)
    found = near_box(OwnProcess(), of, extents_of_tiles(OwnProcess(), of))
    r = distinct(path)
    k = int(0.001 * len(r))
    low, high = np.sort(r, axis=0)[[k, -1 - k]]
    room = 100.0 * (high - low).max()
    assert np.array_equal(found, np.r_[low - room, high + room])
    near = tiles_of(write(tmp_path / "near.laz", p[:3000], rng), tmp_path / "other", 20.0)
    extents = extents_of_tiles(OwnProcess(), near)
    assert near_box(OwnProcess(), near, extents) is EVERYWHERE
    at_most, at_least = bounds(extents, 2)  # of 3,000 points
    r = np.sort(distinct(tmp_path / "near.laz"), axis=0)
    assert (at_most >= r[2]).all() and (at_least <= r[-3]).all()
    assert (at_most < r[-3]).all() and (at_least > r[2]).all()

"""GeoTIFF rasters of heights and PTS files as point clouds."""

import json
import warnings

import numpy as np
import pytest
import rasterio

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import Reading, read_cloud
from ladar_volume.model.errors import CloudError

PLACE = rasterio.Affine(0.5, 0.0, 500_000.0, 0.0, -0.5, 5_400_010.0)


def raster(path, z, place=PLACE, crs="EPSG:25832", kind="float32", nodata=-9999.0, unit=None):
    profile = {"driver": "GTiff", "dtype": kind, "count": 1, "width": z.shape[1]}
    profile |= {"height": z.shape[0], "crs": crs, "transform": place, "nodata": nodata}
    with rasterio.open(path, "w", **profile) as file:
        file.write(z.astype(kind), 1)
        if unit:
            file.set_band_unit(1, unit)
    return path


def heights(seed=1):
    z = 100.0 + np.random.default_rng(seed).normal(0.0, 0.1, (20, 30))
    z[3, 4] = -9999.0
    z[5, 6] = np.nan
    return z


def test_cells_become_points_at_their_middles(tmp_path):
    z = heights()
    cloud = read_cloud(raster(tmp_path / "a.tif", z))
    row, column = np.nonzero(np.isfinite(z) & (z > 0.0))
    assert len(cloud) == 598
    assert cloud.r[:, 0] == pytest.approx(500_000.0 + 0.5 * (column + 0.5), abs=1e-9)
    assert cloud.r[:, 1] == pytest.approx(5_400_010.0 - 0.5 * (row + 0.5), abs=1e-9)
    assert cloud.r[:, 2] == pytest.approx(z[row, column], abs=1e-4)
    assert "25832" in cloud.coordinates.words


def test_units_turns_and_whole_numbers(tmp_path):
    z = np.round(heights())
    z[5, 6] = -9999.0
    turn = rasterio.Affine.translation(1e6, 2e6) * rasterio.Affine.rotation(30.0)
    cloud = read_cloud(raster(tmp_path / "feet.tiff", z, turn, "EPSG:2263", "int16", unit="US ft"))
    foot = 1200.0 / 3937.0
    assert cloud.r[:, 2] == pytest.approx(z[z > 0.0] * foot)
    near = np.hypot(*(cloud.r[1] - cloud.r[0])[:2])
    assert near == pytest.approx(foot, rel=1e-6)
    plain = raster(tmp_path / "plain.tif", z, crs=None)
    assert read_cloud(plain, reading=Reading(None, None, None)).r[0, 2] == 100.0


def test_a_volume_of_a_raster_that_the_program_wrote(tmp_path, capsys):
    rng = np.random.default_rng(5)
    xy = rng.uniform(-12.0, 12.0, (6000, 2))
    z = np.maximum(0.0, 2.5 - 0.6 * np.hypot(*xy.T)) + rng.normal(0.0, 0.01, 6000)
    np.savetxt(tmp_path / "c.xyz", np.c_[xy, z])
    words = ["volume", str(tmp_path / "c.xyz"), "--units", "m", "-o", str(tmp_path / "out")]
    assert main([*words, "--as", "tif"]) == 0
    capsys.readouterr()
    assert main(["volume", str(tmp_path / "out" / "surface.tif"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    truth = np.pi * (2.5 / 0.6) ** 2 * 2.5 / 3.0
    assert abs(facts["net_m3"] - truth) < 3.0 * facts["sigma_m3"] < 0.03 * truth


def test_what_is_no_raster_of_heights_is_refused(tmp_path):
    whole = raster(tmp_path / "a.tif", heights()).read_bytes()
    for number, (data, words) in enumerate((
        (whole[:60], "damaged or cut short"),
        (whole[:1500], "damaged or cut short"),
        (b"no raster", "no GeoTIFF"),
    )):  # fmt: skip
        path = tmp_path / f"{number}.tif"
        path.write_bytes(data)
        with pytest.raises(CloudError, match=words):
            read_cloud(path)
    with pytest.raises(CloudError, match="no cell has a height"):
        read_cloud(raster(tmp_path / "b.tif", np.full((4, 4), -9999.0)))
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        picture = raster(tmp_path / "c.tif", heights(), rasterio.Affine.identity(), None)
    with warnings.catch_warnings(), pytest.raises(CloudError, match="no place on the map"):
        warnings.simplefilter("error")
        read_cloud(picture)


@pytest.mark.parametrize("columns", [3, 4, 6, 7])
def test_pts_with_its_count(tmp_path, columns):
    table = np.random.default_rng(2).uniform(0.0, 9.0, (200, columns)).round(3)
    path = tmp_path / "a.pts"
    np.savetxt(path, table, fmt="%.3f", header="200", comments="")
    cloud = read_cloud(path)
    assert np.array_equal(cloud.r, table[:, :3])
    more = {4: {"intensity"}, 6: {"red", "green", "blue"}}
    more[7] = more[4] | more[6]
    assert set(cloud.columns) == more.get(columns, set())
    np.savetxt(path, table[:150], fmt="%.3f", header="200", comments="")
    with pytest.raises(CloudError, match="200 points are announced in the first line, 150"):
        read_cloud(path)

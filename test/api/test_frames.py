"""Answers as tables of geopandas and rasters of xarray: the numbers of the answer."""

from __future__ import annotations

import sys

import numpy as np
import pyproj
import pytest

import ladar_volume as lv
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.model.errors import ConfigurationError


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    rng = np.random.default_rng(6)
    xy = rng.uniform(-8, 8, (4000, 2))
    z = np.maximum(0, 3 - np.hypot(*xy.T)) + 0.01 * rng.normal(size=len(xy))
    path = tmp_path_factory.mktemp("cone") / "cone.ply"
    write_cloud(path, np.c_[xy[:, 0] + 4e5, xy[:, 1] + 5e6, z])
    return lv.volume(path, 0.5, crs="EPSG:25832", outline="auto")


def test_a_table_has_the_outline_with_its_volume(answer):
    frame = answer.to_geodataframe()
    assert len(frame) == 1 and pyproj.CRS(frame.crs).to_epsg() == 25832
    (row,) = frame.to_dict("records")
    assert row["volume_m3"] == answer.net_m3 and row["sigma_m3"] == answer.sigma_m3
    assert row["geometry"].area == pytest.approx(answer.area_m2, rel=1e-9)


def test_a_raster_holds_the_surface_its_sigma_and_its_base(answer):
    raster = answer.to_xarray(cell_m=0.1)
    assert pyproj.CRS(raster.spatial_ref.attrs["crs_wkt"]).to_epsg() == 25832
    assert raster.height.dims == ("y", "x") and raster.y[0] > raster.y[-1]
    above = (raster.height - raster.base).sum() * raster.attrs["cell_m"] ** 2
    assert float(above) == pytest.approx(answer.net_m3, rel=0.01)
    top = raster.height.where(raster.height == raster.height.max(), drop=True)
    assert abs(float(top.x[0]) - 4e5) < 0.3 and abs(float(top.y[0]) - 5e6) < 0.3
    assert 0.004 < float(raster.sigma.median()) < 0.012


def test_what_is_missing_is_named(answer, monkeypatch):
    for package, call in (("geopandas", answer.to_geodataframe), ("xarray", answer.to_xarray)):
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(ImportError, match=f"needs {package}: pip install"):
            call()


def test_a_surface_over_another_plane_is_no_map(answer):
    rng = np.random.default_rng(7)
    r = np.c_[rng.uniform(1, 3, (500, 1)), rng.uniform(-1, 1, (500, 2))]
    seen = lv.volume(r, 0.0, frame="scan", direction=(1.0, 0.0, 0.0))
    with pytest.raises(ConfigurationError, match="frame='level'"):
        seen.to_geodataframe()

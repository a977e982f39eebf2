"""Answers as tables of geopandas and rasters of xarray: the numbers of the answer."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyproj
import pytest

import ladar_volume as lv
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.model.errors import ConfigurationError

DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def answer(tmp_path_factory, cone_points):
    path = tmp_path_factory.mktemp("utm") / "cone.ply"
    write_cloud(path, cone_points + np.array([4e5, 5e6, 0.0]))
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


@pytest.mark.parametrize(
    "file, options, code",
    [
        ("road_crop.xml", {"base": 14.0, "surface": "Highest"}, 3875),  # faces, no noise
        ("isprs_samp41.pcd", {"base": 260.0, "units": "m"}, None),  # airborne, with holes
    ],
)
def test_tables_and_rasters_of_real_files_have_their_volume(file, options, code):
    found = lv.volume(DATA / file, **options)
    frame, raster = found.to_geodataframe(), found.to_xarray(cell_m=0.25)
    above = float((raster.height - raster.base).sum()) * raster.attrs["cell_m"] ** 2
    assert above == pytest.approx(found.net_m3, rel=0.005)
    assert frame.geometry.area.sum() == pytest.approx(found.area_m2, rel=1e-9)
    assert (None if frame.crs is None else frame.crs.to_epsg()) == code
    assert ("spatial_ref" in raster.coords) == (code is not None)
    assert bool(np.isnan(raster.sigma).all()) == (not np.isfinite(found.sigma_m3))

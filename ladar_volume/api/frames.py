"""Results as the tables of geopandas and the rasters of xarray."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.io.export.deliverable import Deliverable
from ladar_volume.io.export.height_raster import BANDS, grid_of, rows_of_heights
from ladar_volume.io.export.map_features import outline_features
from ladar_volume.io.export.positions import Positions

if TYPE_CHECKING:
    import geopandas
    import xarray

#: Names of the bands of a raster.
NAMES = ("height", "sigma", "base")


def import_extra(package: str) -> Any:
    """A package of the extra ``frames``. Raises ImportError, which says how to install it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        words = f"needs {package}: pip install 'ladar_volume[frames]'"
        raise ImportError(words) from error


def geodataframe_of(d: Deliverable) -> geopandas.GeoDataFrame:
    """One row for each outline of what counts, with its volume, sigma and area, in the coordinate
    system of the cloud; polygons in three dimensions.
    """
    frame = import_extra("geopandas").GeoDataFrame
    at = Positions(d.system, "x, y, z of the points")
    return frame.from_features(list(outline_features(d, at)), crs=d.system.crs)


def dataset_of(d: Deliverable, cell_m: float | None) -> xarray.Dataset:
    """Heights of the surface, their standard deviations and, where there is one, the heights of the
    base under what counts, m, over y (from north to south) and x, at the middles of the cells; NaN
    outside. Raises :class:`ladar_volume.model.errors.OutputError` for too many cells.
    """
    xr, grid = import_extra("xarray"), grid_of(d, cell_m)
    count = len(NAMES) if d.base_m is not None else len(NAMES) - 1
    bands = np.empty((count, grid.rows, grid.columns))
    for first, some in rows_of_heights(d, grid):
        bands[:, first : first + len(some[0])] = some
    data = {
        name: (("y", "x"), band, {"units": "m", "long_name": words})
        for name, words, band in zip(NAMES, BANDS, bands, strict=False)
    }
    axes = {"x": grid.x_m, "y": grid.y_m(0, grid.rows)}
    found: xarray.Dataset = xr.Dataset(
        data,
        {name: (name, at, {"units": "m"}) for name, at in axes.items()},
        {"survey": d.name, "cell_m": grid.cell_m},
    )
    if d.system.crs is not None:
        # where rioxarray and GDAL's netCDF driver look for it
        found.coords["spatial_ref"] = ((), 0, {"crs_wkt": d.system.wkt})
    return found

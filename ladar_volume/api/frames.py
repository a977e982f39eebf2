"""Answers as tables and rasters of geopandas and xarray."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ladar_volume.io.export.deliverable import Deliverable
from ladar_volume.io.export.height_raster import BANDS, grid_of, heights_at
from ladar_volume.io.export.map_features import outline_features
from ladar_volume.tin.locate import triangle_index

if TYPE_CHECKING:
    import geopandas
    import xarray

#: Names of the bands of a raster.
NAMES = ("height", "sigma", "base")


def needs(package: str) -> ImportError:
    """What is said where a package is missing."""
    return ImportError(f"needs {package}: pip install 'ladar_volume[frames]'")


def geodataframe_of(d: Deliverable) -> geopandas.GeoDataFrame:
    """One row for each outline of what counts, with its volume, sigma and area, in the coordinate
    system of the cloud; polygons in three dimensions.
    """
    try:
        import geopandas
    except ImportError as error:
        raise needs("geopandas") from error
    return geopandas.GeoDataFrame.from_features(list(outline_features(d)), crs=d.system.crs)


def dataset_of(d: Deliverable, cell_m: float | None) -> xarray.Dataset:
    """Heights of the surface, their standard deviations and, where there is one, the heights of the
    base under what counts, m, over y (from north to south) and x, at the middles of the cells; NaN
    outside. Raises :class:`ladar_volume.model.errors.OutputError` for too many cells.
    """
    try:
        import xarray
    except ImportError as error:
        raise needs("xarray") from error
    grid = grid_of(d, cell_m)
    xy = grid.middles(0, grid.rows)
    bands = heights_at(d, xy, triangle_index(d.tin, d.tin.relevant))
    shape, unit = (grid.rows, grid.columns), {"units": "m"}
    data = {
        name: (("y", "x"), band.reshape(shape), {**unit, "long_name": words})
        for name, words, band in zip(NAMES, BANDS, bands, strict=False)
    }
    x, y = xy[: grid.columns, 0], xy[:: grid.columns, 1]
    axes = {"x": ("x", x, unit), "y": ("y", y, unit)}
    found = xarray.Dataset(data, axes, {"survey": d.name, "cell_m": grid.cell_m})
    if d.system.crs is None:
        return found
    # where rioxarray and GDAL's netCDF driver look for it
    return found.assign_coords(spatial_ref=((), 0, {"crs_wkt": d.system.wkt}))

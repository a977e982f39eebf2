"""GeoTIFF rasters of heights as point clouds: the middle of every cell that has a height."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from ladar_volume.io.pointfiles.crs import Coordinates, coordinates_of, crs_of_text
from ladar_volume.io.pointfiles.raw_table import RawTable
from ladar_volume.io.pointfiles.units import unit_of_word
from ladar_volume.model.errors import CloudError
from ladar_volume.model.records import F64

#: Most cells of a raster: its heights, places and gaps fit the memory of a laptop.
MOST = 200_000_000


def read_geotiff(path: Path) -> RawTable:
    """x, y, z of the cells with a height in the first band, row by row from the upper left. A band
    of standard deviations is not taken for noise: cells share the points they were made of.

    Raises :class:`CloudError` (cloud_header, cloud_values, cloud_fields, cloud_empty), InputError
    (input_crs), and ModuleNotFoundError without rasterio.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # refused below
            file = rasterio.open(path, driver="GTiff")
        with file:
            if file.width * file.height > MOST:
                words = f"{file.width} by {file.height} cells are too many: cut the raster"
                raise CloudError(words, reason="cloud_values", value=file.width * file.height)
            if np.dtype(file.dtypes[0]).kind not in "fiu" or file.transform.is_identity:
                raise CloudError(
                    "a picture, not a raster of heights: it has no place on the map, or no numbers",
                    reason="cloud_fields",
                )
            z = file.read(1, out_dtype="float64")
            seen = (file.read_masks(1) > 0) & np.isfinite(z)
            said = stated_coordinates(file.crs, file.units[0])
            place = np.array(file.transform[:6]).reshape(2, 3)
    except RasterioError as error:
        raise CloudError(
            f"no GeoTIFF, damaged or cut short: {error}", reason="cloud_header"
        ) from error
    if not seen.any():
        raise CloudError("no cell has a height", reason="cloud_empty")
    xy = middles(seen, place)
    return RawTable({"x": xy[:, 0], "y": xy[:, 1], "z": z[seen]}, said)


def middles(seen: np.ndarray[tuple[int, int], np.dtype[np.bool_]], place: F64) -> F64:
    """Places (n, 2) of the middles of cells; place : (2, 3), from column, row, 1 to x, y."""
    row, column = np.nonzero(seen)
    at = np.column_stack([column + 0.5, row + 0.5, np.ones(len(row))])
    out: F64 = at @ place.T
    return out


def stated_coordinates(crs: object | None, unit: str | None) -> Coordinates | None:
    """What the raster says of its system, and of the unit of its heights; None for nothing."""
    up = unit_of_word(unit) if unit else None
    if crs is None:
        return None if up is None else Coordinates(up=up)
    said = coordinates_of(crs_of_text(wkt_of(crs), "the raster"), "header")
    return said if up is None or said.up is not None else replace(said, up=up)


def wkt_of(crs: object) -> str:
    """A system of rasterio as WKT."""
    return str(crs.to_wkt())  # type: ignore[attr-defined]

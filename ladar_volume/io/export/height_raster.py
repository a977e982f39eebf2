"""GeoTIFF of heights: surface, its standard deviation, and the base where the volume counts, in
double precision.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ladar_volume.io.export.deliverable import Deliverable
from ladar_volume.io.export.outline_clip import contains
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.locate import TriangleIndex, barycentric, interpolate_heights, triangle_index

#: Most cells of a raster (three bands of 8 bytes: 2.4 GB), and cells that are computed at a time.
MOST, BLOCK = 100_000_000, 500_000
#: Cells that a cell size of its own choice makes at most.
OWN_MOST = 16_000_000
#: What the bands hold.
BANDS = ("height", "sigma of the height (1 sigma)", "height of the base where the volume counts")


@dataclass(frozen=True)
class Grid:
    """cell_m · west_m, north_m : of its corner, whole multiples of the cell · rows, columns"""

    cell_m: float
    west_m: float
    north_m: float
    rows: int
    columns: int

    @property
    def x_m(self) -> F64:
        """Middles (columns,), m, from west to east."""
        return self.west_m + self.cell_m * (np.arange(self.columns, dtype=np.float64) + 0.5)

    def y_m(self, first: int, last: int) -> F64:
        """Middles (k,), m, of rows first to last, from north to south."""
        return self.north_m - self.cell_m * (np.arange(first, last, dtype=np.float64) + 0.5)

    def middles(self, first: int, last: int) -> F64:
        """Middles (k, 2), m, of the cells of rows first to last."""
        at = np.meshgrid(self.x_m, self.y_m(first, last))
        out: F64 = np.stack(at, axis=-1).reshape(-1, 2)
        return out


def grid_of(d: Deliverable, cell: float | None) -> Grid:
    """A grid over the surface; without a cell size (units of the files) about one cell a vertex.
    Raises :class:`OutputError` for too many cells.
    """
    tin = d.tin
    triangles = tin.triangles[tin.relevant]
    used = np.unique(triangles)
    xy = tin.vertices[used, :2]
    low, high = xy.min(axis=0), xy.max(axis=0)
    to = d.system.unit.metres
    cell_m = 0.0 if cell is None else cell * to
    if cell is None:
        area = float(footprint_areas(tin.vertices, triangles).sum())
        least = math.sqrt(float(np.prod(high - low)) / OWN_MOST)
        cell_m = round_up(max(math.sqrt(area / len(used)), least) / to) * to
    west, south = np.floor(low / cell_m) * cell_m
    north = math.ceil(high[1] / cell_m) * cell_m
    columns = max(1, math.ceil((high[0] - west) / cell_m))
    rows = max(1, round((north - south) / cell_m))
    if rows * columns > MOST:
        raise OutputError(
            f"cells of {cell_m / to:g} make {rows:,} x {columns:,} of them, more than {MOST:,}: "
            "give larger ones (--cell)",
            reason="output_cells",
            value=cell_m,
        )
    return Grid(cell_m, float(west), float(north), rows, columns)


def round_up(value: float) -> float:
    """The next number of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(f * power for f in (1.0, 2.0, 5.0, 10.0) if f * power >= value * (1.0 - 1e-9))


def write_tif(path: Path, d: Deliverable, cell: float | None) -> None:
    """Write the bands; cells outside the surface are NaN. Raises :class:`OutputError`."""
    import rasterio
    from rasterio.windows import Window

    grid = grid_of(d, cell)
    to = d.system.unit.metres
    known = d.base_m is not None
    crs = d.system.crs
    # GeoTIFF has no keys for a projected system of three axes
    flat = crs.to_2d() if crs is not None and crs.is_projected and not crs.is_compound else crs
    transform = rasterio.Affine(
        grid.cell_m / to, 0.0, grid.west_m / to, 0.0, -grid.cell_m / to, grid.north_m / to
    )
    profile = {
        "driver": "GTiff",
        "dtype": "float64",
        "width": grid.columns,
        "height": grid.rows,
        "count": 3 if known else 2,
        "crs": None if flat is None else rasterio.CRS.from_wkt(flat.to_wkt()),
        "transform": transform,
        "nodata": math.nan,
        "compress": "deflate",
        "predictor": 3,
        "bigtiff": "if_safer",
    }
    with rasterio.open(path, "w", **profile) as file:
        for first, bands in rows_of_heights(d, grid):
            window = Window(0, first, grid.columns, len(bands[0]))
            for number, band in enumerate(bands, 1):
                file.write(band / to, number, window=window)
        for number in range(1, profile["count"] + 1):
            file.set_band_description(number, BANDS[number - 1])
            file.set_band_unit(number, d.system.unit.name)
        file.update_tags(UNITS=d.system.unit.name, SURVEY=d.name, SYSTEM=d.system.name)


def rows_of_heights(d: Deliverable, grid: Grid) -> Iterator[tuple[int, list[F64]]]:
    """The bands of a grid a few rows at a time: the first of the rows, and each band (rows,
    columns), m, as :func:`heights_at`.
    """
    index, step = triangle_index(d.tin, d.tin.relevant), max(1, BLOCK // grid.columns)
    for first in range(0, grid.rows, step):
        bands = heights_at(d, grid.middles(first, min(first + step, grid.rows)), index)
        yield first, [band.reshape(-1, grid.columns) for band in bands]


def heights_at(d: Deliverable, xy: F64, index: TriangleIndex) -> list[F64]:
    """Height, sigma and, where there is one, base (k,), m, at places xy (k, 2); NaN outside."""
    found = interpolate_heights(d.tin, xy, d.covariance, index)
    weight = barycentric(d.tin, found.triangle, xy)
    corner = d.tin.triangles[found.triangle]
    sigma = found.sigma_m
    if d.covariance is None and d.sigma_m is not None:
        sigma = (weight * d.sigma_m[corner]).sum(axis=1)
    sigma = np.where(found.triangle >= 0, sigma, np.nan)
    if d.base_m is None:
        return [found.height_m, sigma]
    inside = (found.triangle >= 0) & d.counted[found.triangle]
    if d.outlines:
        inside &= np.any([contains(outline, xy) for outline in d.outlines], axis=0)
    base = np.where(inside, (weight * d.base_m[corner]).sum(axis=1), np.nan)
    return [found.height_m, sigma, base]

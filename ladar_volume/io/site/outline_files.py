"""Outlines of piles from the files that offices have: GeoJSON, Shapefile, GeoPackage, KML, DXF
(closed polylines) and text in WKT; read by GDAL (pyogrio), transformed into the points' system.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ladar_volume.io.pointfiles.datum_shift import datum_shift, place_of
from ladar_volume.io.pointfiles.metres import MapCoordinates
from ladar_volume.io.pointfiles.raw_table import FARTHEST
from ladar_volume.io.site.outline_reading import MOST_CORNERS, Columns, Features, features_of
from ladar_volume.model.errors import ConfigurationError, InputError, VolumeError, short_repr
from ladar_volume.model.piles import Material, Pile
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt
from ladar_volume.volume.polygon import check_polygon

if TYPE_CHECKING:
    from pyproj import CRS
    from shapely.geometry.base import BaseGeometry

#: Columns that hold what is said of a pile, the first found counts; capitals do not matter.
NAMES = ("name", "pile", "label", "id", "layer")
MATERIALS = ("material", "product")
DENSITIES = ("density_t_m3", "density")
DENSITY_SIGMAS = ("density_sigma_t_m3", "density_sigma", "sigma_density")


@dataclass(frozen=True)
class Outlines:
    """piles · system : of the file, in words · ignored : shapes that are no areas · doubts : what
    is doubtful about where they lie
    """

    piles: list[Pile]
    system: str
    ignored: int = 0
    doubts: tuple[Doubt, ...] = ()


def read_outlines(path: Path, at: MapCoordinates, extent: F64) -> Outlines:
    """The outlines of a file in the system of a cloud's metres.

    at : that system · extent : (2, 2) m, lowest and highest x and y of the points. Raises
    :class:`InputError` for a file that cannot be read, holds no area, or whose system cannot be
    brought together with the points'; ModuleNotFoundError without pyogrio or shapely.
    """
    found = features_of(path)
    every = [rings_of(shape, path) for shape in found.shapes]
    if not any(every):
        raise InputError(
            f"{path.name}: holds no closed area: draw polygons, or closed polylines",
            reason="input_outlines",
        )
    shift = shift_of(found, at, extent, path)
    piles: list[Pile] = []
    ignored = found.no_geometry
    for row, rings in enumerate(every):
        ignored += not rings
        name = text_of(found.columns, NAMES, row) or f"pile {row + 1}"
        material = material_of(found.columns, row, name)
        for number, ring in enumerate(rings, 1):
            own = name if len(rings) == 1 else f"{name} ({number})"
            piles.append(Pile(own, check_ring(shift.apply(ring), own, path), material))
    return Outlines(with_own_names(piles), shift.words, ignored, shift.doubts)


def with_own_names(piles: list[Pile]) -> list[Pile]:
    """The piles with a number where several have one name."""
    names = [pile.name for pile in piles]
    seen: dict[str, int] = {}
    out = []
    for pile in piles:
        seen[pile.name] = seen.get(pile.name, 0) + 1
        again = names.count(pile.name) > 1
        name = f"{pile.name} #{seen[pile.name]}" if again else pile.name
        out.append(Pile(name, pile.ring, pile.material))
    return out


def rings_of(shape: BaseGeometry, path: Path) -> list[F64]:
    """Rings (k, 2) of the areas of a shape, none for points and open lines. Raises
    :class:`InputError` for holes.
    """
    parts = list(shape.geoms) if hasattr(shape, "geoms") else [shape]
    if hasattr(shape, "geoms"):
        return [ring for part in parts for ring in rings_of(part, path)]
    if shape.is_empty:
        return []
    if shape.geom_type == "Polygon":
        if len(shape.interiors):
            raise InputError(
                f"{path.name}: an outline has a hole: draw the pile as areas without holes",
                reason="input_outlines",
            )
        return [ring_of(shape.exterior.coords)]
    if shape.geom_type == "LineString" and shape.is_closed and len(shape.coords) >= 4:
        return [ring_of(shape.coords)]
    return []


def ring_of(coords: Iterable[Sequence[float]]) -> F64:
    """x and y (k, 2) of a closed line, its first corner not repeated, nor any other."""
    xy = np.array([c[:2] for c in coords], dtype=np.float64)
    keep = np.r_[True, (xy[1:] != xy[:-1]).any(axis=1)]
    xy = xy[keep]
    return xy[:-1] if len(xy) > 1 and np.array_equal(xy[0], xy[-1]) else xy


def check_ring(ring: F64, name: str, path: Path) -> F64:
    """A ring (k, 2), m, counter-clockwise. Raises :class:`InputError`."""
    if len(ring) > MOST_CORNERS:
        raise InputError(
            f"{path.name}: {name} has {len(ring):,} corners; simplify it", reason="input_outlines"
        )
    if not (np.abs(ring) < FARTHEST).all():
        words = f"{path.name}: {name} has a corner that is not below {FARTHEST:g}"
        raise InputError(words, reason="input_outlines")
    try:
        return check_polygon(ring)
    except VolumeError as error:
        raise InputError(f"{path.name}: {name}: {error}", reason="input_outlines") from error


@dataclass(frozen=True)
class Shift:
    """How coordinates of a file become those of the points: by a transformation (pyproj), or times
    a factor (m per unit).
    """

    words: str
    factor: float = 1.0
    change: Any = None
    doubts: tuple[Doubt, ...] = ()

    def apply(self, ring: F64) -> F64:
        """A ring (k, 2) in m of the points."""
        if self.change is None:
            return ring * self.factor
        x, y = self.change.transform(ring[:, 0], ring[:, 1])
        return np.column_stack([x, y])


def shift_of(found: Features, at: MapCoordinates, extent: F64, path: Path) -> Shift:
    """How the outlines come to lie on the points. Raises :class:`InputError` (input_crs)."""
    own = f"coordinates of the points ({at.words})"
    if found.crs is None:
        return Shift(f"none named: {own}", factor_of(at, path))
    if at.crs is None:
        if found.default_crs and meets(found.shapes, extent / factor_of(at, path)):
            # a file of this format that names nothing, drawn over points that name nothing
            return Shift(f"none named: {own}", factor_of(at, path))
        raise InputError(
            f"{path.name} is in {found.crs.name}, and the points name no CRS: say theirs with "
            "--crs",
            reason="input_crs",
            value=found.crs.name,
        )
    if found.default_crs and not geographic_numbers(found.shapes):
        return Shift(f"none named: {own}", factor_of(at, path))
    return transform_shift(found.crs, at.crs, extent)


def factor_of(at: MapCoordinates, path: Path) -> float:
    """Metres per unit of the points' file. Raises :class:`InputError` for degrees."""
    if at.across is None:
        raise InputError(
            f"{path.name} names no CRS, and the points are in degrees: save the outlines with "
            "their system",
            reason="input_crs",
        )
    return at.factor[0]


def transform_shift(source: CRS, target: CRS, extent: F64) -> Shift:
    """By pyproj, horizontally, as it fits the points. Raises :class:`InputError` (input_crs)."""
    shift = datum_shift(source, target, place_of(target, *extent.mean(axis=0).tolist()))
    doubts: tuple[Doubt, ...] = ()
    if shift.doubtful:
        words = (
            f"the outlines are brought from {source.name} to {target.name} to "
            f"{shift.accuracy_words}: they may lie beside the piles; export them in the system of "
            "the points"
        )
        doubts = (Doubt("outline_datum", words, shift.accuracy_m),)
    return Shift(str(source.name), 1.0, shift.transformer, doubts)


def bounds(shapes: Sequence[BaseGeometry]) -> F64:
    """Lowest and highest x and y, (2, 2)."""
    every = np.array([s.bounds for s in shapes if not s.is_empty]).reshape(-1, 4)
    if not len(every):
        return np.full((2, 2), math.nan)
    return np.array([every[:, :2].min(axis=0), every[:, 2:].max(axis=0)])


def meets(shapes: Sequence[BaseGeometry], extent: F64) -> bool:
    """Whether shapes lie over an extent (2, 2)."""
    low, high = bounds(shapes)
    return bool((low <= extent[1]).all() and (high >= extent[0]).all())


def geographic_numbers(shapes: Sequence[BaseGeometry]) -> bool:
    """Whether all coordinates can be longitude and latitude."""
    low, high = bounds(shapes)
    return bool(low[0] >= -360 and high[0] <= 360 and low[1] >= -90 and high[1] <= 90)


def text_of(columns: Columns, names: Sequence[str], row: int) -> str:
    """Text in the first of the columns that has some."""
    for value in (v[row] for wanted in names for name, v in columns if name == wanted):
        if value is None or (isinstance(value, float | np.floating) and math.isnan(value)):
            continue
        text = "".join(c for c in str(value).strip() if c.isprintable())[:80]
        if text:
            return text
    return ""


def material_of(columns: Columns, row: int, pile: str) -> Material | None:
    """The material of a pile; None where no density is given. Raises
    :class:`ConfigurationError`.
    """
    density, sigma = (
        _density(text_of(columns, names, row), pile) for names in (DENSITIES, DENSITY_SIGMAS)
    )
    if density is None:
        return None
    try:
        name = text_of(columns, MATERIALS, row)
        return Material(name, density, math.nan if sigma is None else sigma)
    except ConfigurationError as error:
        raise ConfigurationError(f"{pile}: {error}", value=error.value) from error


def _density(text: str, pile: str) -> float | None:
    """A number, or None for nothing."""
    if not text:
        return None
    try:
        return float(text.replace(",", "."))
    except ValueError as error:
        raise ConfigurationError(
            f"{pile}: a density {short_repr(text)} is no number", value=text
        ) from error

"""The way from one coordinate system to another that fits a place (pyproj)."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ladar_volume.io.pointfiles.crs import parts_of
from ladar_volume.model.errors import InputError

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

#: A transformation that is less accurate than this, m, is doubtful. WGS 84 itself is known to 2 m.
ACCURACY_M = 2.0


@dataclass(frozen=True)
class DatumShift:
    """transformer : x, or longitude, before y · accuracy_m : as the EPSG register states it, nan
    where it is not known · same_datum : whether no datum is changed
    """

    transformer: Transformer
    accuracy_m: float
    same_datum: bool

    @property
    def doubtful(self) -> bool:
        """Whether places may be off by more than :data:`ACCURACY_M`."""
        return not self.same_datum and not self.accuracy_m <= ACCURACY_M

    @property
    def accuracy_words(self) -> str:
        """The accuracy in words."""
        return "an unknown accuracy" if math.isnan(self.accuracy_m) else f"{self.accuracy_m:g} m"


def horizontal(crs: CRS) -> CRS:
    """The part of a system that x and y belong to. Raises :class:`InputError` (input_crs)."""
    flat = parts_of(crs)[0]
    if flat is None:
        raise InputError(f"CRS {crs.name}: it has no horizontal part", reason="input_crs")
    return flat.to_2d()


def datum_shift(source: CRS, target: CRS, place: tuple[float, float] | None) -> DatumShift:
    """The most accurate way between the horizontal parts of two systems.

    place : longitude and latitude, degrees, that it must hold for; None: anywhere. Raises
    :class:`InputError` (input_crs) where there is none.
    """
    from pyproj.exceptions import ProjError
    from pyproj.transformer import AreaOfInterest, TransformerGroup

    one, two = horizontal(source), horizontal(target)
    area = None if place is None else AreaOfInterest(*place, *place)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # grids that are missing are in the accuracy
        try:
            group = TransformerGroup(one, two, always_xy=True, area_of_interest=area)
            best = group.transformers[0]
        except (ProjError, IndexError) as error:
            words = f"no way is known from {one.name} to {two.name}"
            raise InputError(words, reason="input_crs", value=one.name) from error
    accuracy = float(best.accuracy)
    same = one.geodetic_crs == two.geodetic_crs
    return DatumShift(best, accuracy if accuracy >= 0.0 else math.nan, same)


def place_of(crs: CRS, x: float, y: float) -> tuple[float, float] | None:
    """Longitude and latitude, degrees, of a point on the system's own datum, as well as areas of
    use need them; None where the system has none, or does not reach there.
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    flat = parts_of(crs)[0]
    if flat is None or flat.geodetic_crs is None:
        return None
    try:
        back = Transformer.from_crs(flat.to_2d(), flat.geodetic_crs.to_2d(), always_xy=True)
        lon, lat = back.transform(x, y)
    except ProjError:
        return None
    known = bool(np.isfinite([lon, lat]).all()) and abs(lat) <= 90.0
    return (float(lon), float(lat)) if known else None

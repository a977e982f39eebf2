"""What the functions of the API return: numbers with their units in their names, the verdict, and
``facts``, which is what the command line prints with ``--json``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

from ladar_volume.model.records import F64, I64, Estimate, Tin

if TYPE_CHECKING:
    import geopandas
    import xarray

    from ladar_volume.io.export.deliverable import Deliverable


@dataclass(frozen=True)
class Answer:
    """facts : as with ``--json``, plain values."""

    facts: Mapping[str, Any] = field(repr=False)

    @property
    def status(self) -> str:
        """``sound`` or ``doubtful``."""
        return str(self.facts["verdict"]["status"])

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the result is doubtful: sentences; none where it is sound."""
        return tuple(str(reason["text"]) for reason in self.facts["verdict"]["reasons"])

    def rows(self) -> list[tuple[str, str]]:
        """Names and values that a person reads first."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        """A small table for a notebook."""
        rows = [*self.rows(), ("verdict", self.status), *(("", text) for text in self.reasons)]
        cells = "".join(
            f"<tr><th style='text-align:left'>{escape(name)}</th>"
            f"<td style='text-align:left'>{escape(value)}</td></tr>"
            for name, value in rows
        )
        return f"<table>{cells}</table>"


@dataclass(frozen=True)
class VolumeAnswer(Answer):
    """A volume above a base, or between two surfaces; net = cut − fill.

    interval_m3 : where the true volume is with probability ``confidence`` · sigma_holds : which
    errors ``sigma_m3`` holds · tin : the first surface · make_deliverable : gives what its files
    hold
    """

    net_m3: float
    sigma_m3: float
    interval_m3: tuple[float, float]
    confidence: float
    cut_m3: float
    fill_m3: float
    area_m2: float
    base: str
    sigma_holds: str
    tin: Tin = field(repr=False)
    make_deliverable: Callable[[], Deliverable] = field(repr=False, compare=False)

    def to_geodataframe(self) -> geopandas.GeoDataFrame:
        """Outlines of what counts, a row each, with volume, sigma and area, in the coordinate
        system of the points.

        Raises ImportError without geopandas (extra ``frames``).
        """
        from ladar_volume.api.frames import geodataframe_of

        return geodataframe_of(self.make_deliverable())

    def to_xarray(self, cell_m: float | None = None) -> xarray.Dataset:
        """Rasters of ``height``, ``sigma`` and ``base``, m, over y and x; without a cell size about
        one cell a vertex.

        Raises ImportError without xarray (extra ``frames``), OutputError for too many cells.
        """
        from ladar_volume.api.frames import dataset_of

        return dataset_of(self.make_deliverable(), cell_m)

    def rows(self) -> list[tuple[str, str]]:
        """Net, interval, cut, fill, area, base."""
        low, high = self.interval_m3
        return [
            ("net volume", measure(self.net_m3, self.sigma_m3)),
            (f"{100 * self.confidence:g} % interval", f"{low:.3f} to {high:.3f} m³"),
            ("sigma holds", self.sigma_holds),
            ("cut", f"{self.cut_m3:.3f} m³"),
            ("fill", f"{self.fill_m3:.3f} m³"),
            ("area", f"{self.area_m2:.2f} m²"),
            ("above", self.base),
        ]


@dataclass(frozen=True)
class FilterAnswer(Answer):
    """A filtered cloud.

    r_m : (k, 3) filtered points, m · normal : (k, 3) unit · sigma_m : (k,) standard deviation along
    the normal, m · index : (k,) which point of the cloud each one was · outliers : (o,) the points
    that were taken out
    """

    r_m: F64 = field(repr=False)
    normal: F64 = field(repr=False)
    sigma_m: F64 = field(repr=False)
    index: I64 = field(repr=False)
    outliers: I64 = field(repr=False)

    def rows(self) -> list[tuple[str, str]]:
        """Points in and out, and their sigma."""
        return [
            ("points in", f"{self.facts['input']['points']:,}"),
            ("points out", f"{len(self.index):,}"),
            ("taken out", f"{len(self.outliers):,}"),
            ("sigma along the normal", f"{1e3 * self.facts['sigma_median_m']:.2f} mm (median)"),
        ]


@dataclass(frozen=True)
class SurveyAnswer(Answer):
    """The volume of a recorded survey with its whole budget.

    budget_m3 : standard deviation of the volume by source · estimate : surface, base and bodies
    """

    volume_m3: float
    sigma_m3: float
    interval_m3: tuple[float, float]
    confidence: float
    area_m2: float
    base: str
    budget_m3: Mapping[str, float]
    estimate: Estimate = field(repr=False)

    def rows(self) -> list[tuple[str, str]]:
        """Volume, interval, area, base and the largest lines of the budget."""
        low, high = self.interval_m3
        first = sorted(self.budget_m3.items(), key=lambda item: -item[1])[:5]
        return [
            ("volume", measure(self.volume_m3, self.sigma_m3)),
            (f"{100 * self.confidence:g} % interval", f"{low:.3f} to {high:.3f} m³"),
            ("area", f"{self.area_m2:.2f} m²"),
            ("above", self.base),
            *((f"± by {name.replace('_', ' ')}", f"{sigma:.3f} m³") for name, sigma in first),
        ]


def measure(value_m3: float, sigma_m3: float) -> str:
    """A volume with its standard deviation; a dash where nobody knows it."""
    sigma = f"{sigma_m3:.3f}" if math.isfinite(sigma_m3) else "–"
    return f"{value_m3:.3f} ± {sigma} m³ (1 sigma)"

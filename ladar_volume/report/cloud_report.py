"""The report of a volume from point cloud or mesh files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.report.report_page import Report, changed_parameters, file_digest, write_report
from ladar_volume.report.scene import Scene, base_of_plane
from ladar_volume.report.survey_report import budget_rows, calibration_rows, lead_of
from ladar_volume.tin.locate import height_at
from ladar_volume.volume.outline import boundary_loop, components


@dataclass(frozen=True)
class CloudReport:
    """files : one or two · surfaces : of each · base : of the first, None where the second is the
    base · counted : (t,) triangles of the first that count · facts : as with ``--json`` · piles :
    outline (k, 2) and plane near the base of each
    """

    files: Sequence[Path]
    surfaces: Sequence[CloudSurface]
    base: Plane | None
    counted: Bool
    facts: Mapping[str, Any]
    piles: Sequence[tuple[F64, Plane | None]] = ()


#: Volume of a row, its standard deviation and unit.
VOLUME = ("net_m3", "sigma_m3", "m³")
#: Most outlines that a map shows, the largest parts first.
OUTLINES = 20


def write_cloud_report(report: CloudReport, page: Path) -> None:
    """The page and its JSON twin. Raises OutputError."""
    facts = report.facts
    lead = lead_of(facts, facts["net_m3"])
    lead = {("Net volume" if name == "Volume" else name): words for name, words in lead.items()}
    lead["Sigma holds"] = str(facts["sigma_holds"])
    lead["1 cm of height"] = f"{facts['centimetre_m3']:.3f} m³"
    tables = {"Budget": budget_rows(facts), "Files": _files(facts), "Parts": _parts(facts)}
    if "piles" in facts:
        del tables["Parts"]
        tables = {"Piles": pile_rows(facts), "Volume by base": base_rows(facts), **tables}
    tables["Options of the surface"] = [
        (name.replace("_", " "), str(value))
        for name, value in facts["options"].items()
        if value not in (None, math.inf)
    ]
    inputs = {path.name: file_digest(path) for path in report.files}
    flown = facts["trajectory"]
    if flown is not None:
        inputs[flown["path"]] = flown["sha256"]
        tables["Trajectory"] = flight_rows(flown)
        used = flown["parameters"]
        tables["Calibration"] = calibration_rows(used["calibration"])
        tables["Parameters that differ from their defaults"] = changed_parameters(used)
    title = " and ".join(path.name for path in report.files)
    write_report(Report(title, facts, lead, tables, _scene(report), inputs), page)


def _scene(report: CloudReport) -> Scene:
    first = report.surfaces[0]
    tin = first.representation.tin
    base_at = base_of_piles(report) if report.piles else base_of_plane(report.base)
    if report.base is None and len(report.surfaces) == 2:
        second = report.surfaces[1].representation.tin

        def base_at(xy: F64) -> F64:
            return height_at(second, xy)

    own = first.sigma_m is not None and len(tin.vertices) == len(first.points)
    return Scene(
        tin=tin,
        counted=report.counted,
        above_m=tin.vertices[:, 2] - base_at(tin.vertices[:, :2]),
        sigma_m=first.sigma_m[tin.source] if own and first.sigma_m is not None else None,
        outlines=_outlines(report),
        base_at=base_at,
        base=str(report.facts["base"]),
        where=_system_words(report.facts),
    )


def base_of_piles(report: CloudReport) -> Callable[[F64], F64]:
    """Height at xy (k, 2) of the plane of the nearest pile."""
    centres = np.array([ring.mean(axis=0) for ring, _ in report.piles])
    planes = [base_of_plane(plane) for _, plane in report.piles]

    def at(xy: F64) -> F64:
        nearest, out = cKDTree(centres).query(xy)[1], np.zeros(len(xy))
        for number, plane in enumerate(planes):
            own = nearest == number
            out[own] = plane(xy[own])
        return out

    return at


def value_with_sigma(row: Mapping[str, Any], value: str, sigma: str, unit: str) -> str:
    """A number of a row with its standard deviation, as far as they are known."""
    if row.get(value) is None:
        return "–"
    spread = "" if row.get(sigma) is None else f" ± {row[sigma]:,.2f}"
    return f"{row[value]:,.2f}{spread} {unit}"


def pile_rows(facts: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Name, volume, tonnes, area, height and verdict of each pile."""
    return [
        (
            f"{row['name']}" + (f", {row['material']}" if row.get("material") else ""),
            value_with_sigma(row, "net_m3", "sigma_m3", "m³"),
            value_with_sigma(row, "mass_t", "sigma_mass_t", "t"),
            value_with_sigma(row, "area_m2", "", "m²"),
            value_with_sigma(row, "height_m", "", "m high"),
            row["verdict"]["status"],
        )
        for row in facts["piles"]
    ]


def base_rows(facts: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The volume of each pile above every base."""
    known = [row for row in facts["piles"] if row["net_m3"] is not None]
    return [
        (
            name.replace("_", " "),
            *(f"{row['name']}: {value_with_sigma(row['bases'][name], *VOLUME)}" for row in known),
        )
        for name in (known[0]["bases"] if known else ())
    ]


def flight_rows(flown: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """What the trajectory beside the cloud was, and how it was read."""
    low, mid, high = flown["range_m"]
    return [
        (str(flown["path"]), f"{flown['poses']:,} poses"),
        ("times of the points", str(flown["clock"])),
        ("points outside", f"{100 * flown['outside']:.2f} %"),
        ("ranges (5, 50, 95 %)", f"{low:.2f}, {mid:.2f}, {high:.2f} m"),
        ("attitudes", str(flown["attitude"])),
        ("sigma of positions", str(flown["position_sigma"])),
        ("sigma of attitudes", str(flown["attitude_sigma"])),
        ("beams", str(flown["beams"])),
    ]


def _outlines(report: CloudReport) -> list[F64]:
    """The outlines of piles, or the outer rings (k, 2) of the largest parts that count."""
    if report.piles:
        return [ring for ring, _ in report.piles]
    tin = report.surfaces[0].representation.tin
    part = components(tin, report.counted)
    count = np.bincount(part[part >= 0])
    largest = np.argsort(-count, kind="stable")[:OUTLINES]
    return [boundary_loop(tin, part == number) for number in largest.tolist()]


def _system_words(facts: Mapping[str, Any]) -> str:
    """The coordinate system in words."""
    if facts["frame"]["name"] != "level":
        return "scan frame: the third axis is the scan direction"
    at = facts["surfaces"][0]["coordinates"]
    name = at["crs"] or "no CRS named"
    code = f" ({at['code']})" if at["code"] else ""
    return f"{name}{code}, in m"


def _files(facts: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (str(each["path"]), f"{each['points']:,} points", f"{each['used']:,} used")
        for each in facts["surfaces"]
    ]


def _parts(facts: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Place, area and heights of the largest parts that count."""
    return [
        (
            f"at {part['x_m']:.2f}, {part['y_m']:.2f} m",
            f"{part['area_m2']:,.2f} m²",
            f"heights {part['bottom_m']:.3f} to {part['top_m']:.3f} m",
        )
        for part in facts["outline_parts"][:OUTLINES]
    ]

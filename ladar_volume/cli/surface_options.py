"""What ``tin`` and ``volume`` have in common on the command line: from a point cloud file to its
surface.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ladar_volume.clouds.cloud_surface import CLEAN, CloudSurface, cloud_surface
from ladar_volume.io.pointfiles.cloud_files import PointFile, read_cloud
from ladar_volume.model.errors import ConfigurationError, InputError, SurfaceError
from ladar_volume.model.records import F64
from ladar_volume.tin.adaptive import CRITERIA
from ladar_volume.tin.diagonal_exchange import MEASURES
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.represent import ADJUST, Represented, SurfaceOptions
from ladar_volume.tin.scan_frame import Frame, frame_along, mean_direction, search_direction

#: Columns that hold a standard deviation, in order of preference.
SIGMAS = ("sigma_z", "sigma")
#: Ways to choose relevant triangles on the command line.
RELEVANT = ("sampled", "all", "corners", "edge", "circumcircle")


def number(text: str) -> float:
    """A finite number from the command line."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def add_surface_options(parser: argparse.ArgumentParser, default_vertices: str) -> None:
    """Declare the options."""
    # argparse takes -1 for a number, but -1e-3 for an option
    parser._negative_number_matcher = re.compile(r"^-(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$")
    g = parser.add_argument_group("surface")
    g.add_argument(
        "--vertices",
        type=number,
        metavar="RATIO|COUNT",
        help=(
            "vertices of the TIN: up to 1 a part of the points (1: every point), above 1 a "
            f"number (default {default_vertices})"
        ),
    )
    g.add_argument(
        "--tolerance",
        type=number,
        metavar="M",
        help="insert points until no residual is larger (in sigmas for residual-sigma)",
    )
    g.add_argument(
        "--criterion",
        choices=CRITERIA,
        default="residual-area",
        help="what the next vertex maximises",
    )
    g.add_argument(
        "--adjust",
        choices=ADJUST,
        default="rms",
        help="elevation adjustment of a partial TIN (default rms)",
    )
    g.add_argument(
        "--iterations",
        type=int,
        metavar="N",
        help="rms-iterated ends after this many steps (default 100)",
    )
    g.add_argument(
        "--height-tolerance",
        type=number,
        metavar="M",
        help="or when no height changes by as much in a step (default 0.0001)",
    )
    g.add_argument(
        "--exchange",
        choices=(*MEASURES, "none"),
        default="none",
        help="exchange diagonals for a better fit",
    )
    g.add_argument(
        "--relevant",
        choices=RELEVANT,
        help=(
            "which triangles count (default sampled: where points were measured, open notches and "
            "gaps left out; corners: up to the convex hull)"
        ),
    )
    g.add_argument(
        "--max-edge", type=number, metavar="M", help="longest edge of a relevant triangle"
    )
    g.add_argument(
        "--max-circle",
        type=number,
        metavar="M",
        help="widest circumcircle of a relevant triangle, diameter",
    )
    g.add_argument(
        "--max-ear",
        type=number,
        metavar="M",
        help="boundary: cut ears with an open edge longer than this",
    )
    g.add_argument(
        "--min-island", type=number, metavar="M2", help="boundary: drop islands smaller than this"
    )
    g.add_argument(
        "--max-hole", type=number, metavar="M2", help="boundary: fill holes up to this size"
    )
    g.add_argument(
        "--clean",
        choices=CLEAN,
        default="auto",
        help=(
            "stray points: auto leaves out those off the surface (default), off none, filter "
            "those that the filter takes out"
        ),
    )
    g.add_argument(
        "--screen",
        type=number,
        metavar="M",
        help="delete points farther than this from the median of their neighbours",
    )
    g.add_argument(
        "--median", type=number, metavar="M", help="give such points that median instead"
    )
    g.add_argument(
        "--window",
        type=number,
        nargs=4,
        metavar=("X0", "Y0", "X1", "Y1"),
        help="map to which the points are cropped",
    )
    g.add_argument(
        "--duplicates",
        type=number,
        metavar="M",
        default=0.0,
        help="points this near an earlier one become no vertices",
    )
    g.add_argument(
        "--bins", type=int, metavar="N", help="bins per row of the initial triangulation"
    )
    g.add_argument(
        "--sigma",
        type=number,
        metavar="M",
        help="standard deviation of the heights; else a column, else estimated",
    )
    g.add_argument(
        "--frame",
        choices=("level", "scan"),
        default="level",
        help="mesh over the horizontal plane, or against the scan direction",
    )
    g.add_argument(
        "--scanner",
        type=number,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="where it stood; else the direction is searched",
    )
    g.add_argument(
        "--direction",
        type=number,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="the scan direction itself",
    )


def surface_options(arguments: argparse.Namespace, default: SurfaceOptions) -> SurfaceOptions:
    """Options of the surface. Raises :class:`ConfigurationError` for those that contradict one
    another.
    """
    a = arguments
    given: dict[str, Any] = {"ratio": default.ratio}
    if a.tolerance is not None and a.vertices is None:
        given["ratio"] = None
    if a.vertices is not None:
        if not a.vertices > 0 or (a.vertices > 1 and a.vertices != int(a.vertices)):
            raise ConfigurationError(
                f"--vertices {a.vertices:g}: a ratio above 0 and up to 1, or a whole number",
                value=a.vertices,
            )
        given["ratio"], given["vertices"] = (
            (a.vertices, None) if a.vertices <= 1 else (None, int(a.vertices))
        )
    relevant = a.relevant or (
        "edge"
        if a.max_edge is not None
        else "circumcircle"
        if a.max_circle is not None
        else "sampled"
    )
    for option, limit, word in (
        ("edge", a.max_edge, "--max-edge"),
        ("circumcircle", a.max_circle, "--max-circle"),
    ):
        if (relevant == option) != (limit is not None):
            raise ConfigurationError(f"--relevant {option} and {word} go together", value=relevant)
    if a.adjust != "rms-iterated" and (a.iterations is not None or a.height_tolerance is not None):
        raise ConfigurationError(
            "--iterations and --height-tolerance belong to --adjust rms-iterated", value=a.adjust
        )
    limits = {
        "max_edge_m": a.max_edge,
        "max_circumdiameter_m": a.max_circle,
        "max_ear_edge_m": a.max_ear,
        "min_island_m2": a.min_island,
        "max_hole_m2": a.max_hole,
        "max_iterations": a.iterations,
        "height_tolerance_m": a.height_tolerance,
    }
    return SurfaceOptions(
        **given,
        tolerance=a.tolerance,
        criterion=a.criterion,
        adjust=a.adjust,
        exchange=a.exchange,
        relevant=relevant,
        window=None if a.window is None else tuple(a.window),
        duplicate_tolerance_m=a.duplicates,
        bins_per_row=a.bins,
        **{key: value for key, value in limits.items() if value is not None},
    )


@dataclass(frozen=True)
class Source:
    """A point cloud file as read: its name and what is in it."""

    path: Path
    cloud: PointFile


def read_source(path: Path) -> Source:
    """Read a cloud file with its columns."""
    return Source(path, read_cloud(path))


def frame_of(arguments: argparse.Namespace, sources: list[Source]) -> Frame | None:
    """The frame of all clouds; None for the map's own. Raises :class:`ConfigurationError` for
    options without their frame.
    """
    a = arguments
    if a.frame == "level":
        if a.scanner is not None or a.direction is not None:
            raise ConfigurationError("--scanner and --direction belong to --frame scan")
        return None
    if a.scanner is not None and a.direction is not None:
        raise ConfigurationError(
            "the scan direction comes from --scanner or from --direction: choose one"
        )
    r = np.concatenate([s.cloud.r for s in sources])
    if a.direction is not None:
        return frame_along(np.array(a.direction))
    if a.scanner is not None:
        return frame_along(mean_direction(r, np.array(a.scanner)), np.array(a.scanner))
    # about a near origin: far coordinates would cost the turned ones their last digits
    return frame_along(search_direction(r - np.floor(r.min(axis=0))))


def sigma_of(
    source: Source, given: float | None, frame: Frame | None
) -> tuple[F64 | float | None, str]:
    """Standard deviations along the frame's z axis and where they come from: given, a column of the
    file, or None (to be estimated).

    A column ``sigma`` beside normals counts along them, as the filter writes it. Raises
    :class:`InputError` for a column that holds none.
    """
    if given is not None:
        return given, "given"
    columns = source.cloud.columns
    name = next((s for s in SIGMAS if s in columns), None)
    if name is None or (name == "sigma_z" and frame is not None):
        return None, ""
    sigma = np.asarray(columns[name])
    if (
        sigma.dtype.kind not in "fiu"
        or sigma.ndim != 1
        or not (np.isfinite(sigma) & (sigma >= 0)).all()
    ):
        raise InputError(
            f"{source.path}: the column {name!r} holds no standard deviations; give --sigma",
            reason="input_sigma",
        )
    sigma = sigma.astype(np.float64)
    if name == "sigma" and "normal" in columns:
        axis = np.array([0.0, 0.0, 1.0]) if frame is None else frame.R_frame_map[2]
        up = np.abs(np.asarray(columns["normal"], dtype=np.float64) @ axis)
        return sigma / np.clip(np.nan_to_num(up), 0.05, 1.0), "column 'sigma' along the normals"
    return sigma, f"column {name!r}"


def make_surface(
    arguments: argparse.Namespace,
    source: Source,
    options: SurfaceOptions,
    frame: Frame | None,
    sigma: float | None,
    how: str | None = None,
) -> CloudSurface:
    """The surface of one file, cleaned as the arguments say, or ``how``. Errors name it."""
    values, words = sigma_of(source, sigma, frame)
    r = source.cloud.r if frame is None else frame.points(source.cloud.r)
    try:
        return cloud_surface(
            r,
            options,
            values,
            words,
            arguments.screen,
            arguments.median,
            arguments.clean if how is None else how,
        )
    except SurfaceError as error:
        raise SurfaceError(
            f"{source.path}: {error}", reason=error.reason, value=error.value
        ) from error


def surface_facts(source: Source, surface: CloudSurface) -> dict[str, Any]:
    """What the JSON says of one surface."""
    made, tin = surface.made, surface.made.tin
    return {
        "path": source.path.name,
        "points": len(source.cloud.r),
        "used": len(surface.points) - made.cropped,
        "cropped": made.cropped,
        "clean": {"strays": len(surface.strays), "share": stray_share(source, surface)},
        "copies": surface.copies,
        "outliers": len(surface.outliers),
        "sampled": sampled_facts(made),
        "duplicates": tin.duplicates,
        "vertices": int(np.count_nonzero(tin.source >= 0)),
        "vertices_from_bins": made.initial,
        "triangles": len(tin.triangles),
        "relevant_triangles": int(np.count_nonzero(tin.relevant)),
        "area_m2": float(footprint_areas(tin.vertices, tin.triangles)[tin.relevant].sum()),
        "adjust": made.adjust,
        "converged": made.converged,
        "exchanges": made.exchanges,
        "rms_m": made.rms_m,
        "asd_m": made.asd_m,
        "fitted_points": made.fitted,
        "rms_before_m": made.rms_before_m,
        "asd_before_m": made.asd_before_m,
        "sigma_from": surface.sigma_from,
        "sigma_held_fixed": held_fixed(made),
        "sigma_factor": math.sqrt(made.variance_factor),
        "sigma_point_m": None if surface.sigma_m is None else float(np.median(surface.sigma_m)),
    }


def stray_share(source: Source, surface: CloudSurface) -> float:
    """Share of the points that are strays; each counts once."""
    return len(surface.strays) / max(len(source.cloud.r) - surface.copies, 1)


def sampled_facts(made: Represented) -> dict[str, Any] | None:
    """The area that was sampled, against the convex hull; None where it was not asked for."""
    found = made.sampled
    if found is None:
        return None
    return {
        "by": "convex hull" if math.isnan(found.spacing_m) else "spacing of the points",
        "area_m2": found.area_m2,
        "hull_m2": found.hull_m2,
        "spacing_m": None if math.isnan(found.spacing_m) else found.spacing_m,
        "holes": found.holes,
        "hole_m2": found.hole_m2,
        "parts": found.parts,
    }


def add_surface_rows(table: Table, each: Mapping[str, Any]) -> None:
    """Rows on strays, copies and the sampled area of one surface (:func:`surface_facts`)."""
    clean, sampled = each["clean"], each["sampled"]
    if clean["strays"]:
        table.add_row("  strays", f"{clean['strays']:,} left out ({100 * clean['share']:.2f} %)")
    if each["copies"]:
        table.add_row("  copies", f"{each['copies']:,} points with the same coordinates left out")
    if sampled is None:
        return
    if sampled["spacing_m"] is None:
        words = f"{sampled['hull_m2']:.6g} m², the convex hull (too few points to tell more)"
    else:
        words = (
            f"{sampled['area_m2']:.6g} m² of {sampled['hull_m2']:.6g} m² within the convex hull, "
            f"spacing {sampled['spacing_m']:.3g} m"
        )
    table.add_row("  sampled", words)
    if sampled["holes"]:
        table.add_row("  holes", f"{sampled['holes']} bridged, {sampled['hole_m2']:.4g} m²")
    if sampled["parts"] > 1:
        table.add_row("  parts", f"{sampled['parts']} that do not touch")


def held_fixed(made: Represented) -> list[str]:
    """What the standard deviations of a surface take for given, though the noise of the points has
    a part in it.
    """
    partial = ["choice of vertices"] if made.initial or len(made.tin.vertices) < made.fitted else []
    return ["triangulation", *partial, *(["exchanged diagonals"] if made.exchanges else [])]


def option_facts(options: SurfaceOptions) -> dict[str, Any]:
    """The options a surface was made with."""
    names = (
        "vertices",
        "ratio",
        "tolerance",
        "criterion",
        "adjust",
        "exchange",
        "relevant",
        "max_edge_m",
        "max_circumdiameter_m",
        "max_ear_edge_m",
        "min_island_m2",
        "max_hole_m2",
        "window",
        "duplicate_tolerance_m",
        "bins_per_row",
        "max_iterations",
        "height_tolerance_m",
    )
    return {name: getattr(options, name) for name in names}


def frame_facts(frame: Frame | None) -> dict[str, Any]:
    """The frame: its name, and where it is turned its origin and axes in the map."""
    if frame is None:
        return {"name": "level"}
    return {
        "name": "scan",
        "origin_map_m": frame.origin_map.tolist(),
        "axes_map": frame.R_frame_map.tolist(),
    }

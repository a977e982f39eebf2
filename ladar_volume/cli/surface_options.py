"""What ``tin`` and ``volume`` have in common on the command line: from a point cloud file to its
surface.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from ladar_volume.cli.inputs.mesh_source import face_facts, read_faces, surface_of_mesh
from ladar_volume.cli.inputs.reading import Source, cloud_facts_of, mesh_in_metres, read_source
from ladar_volume.clouds.cloud_surface import CloudSurface, cloud_surface
from ladar_volume.io.pointfiles.cloud_files import PointFile
from ladar_volume.io.pointfiles.metres import MapCoordinates
from ladar_volume.model.errors import ConfigurationError, InputError, SurfaceError
from ladar_volume.model.records import F64, LEAST_UPWARD
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.represent import RepresentedSurface
from ladar_volume.tin.scan_frame import Frame, frame_along, mean_direction, search_direction

#: Columns that hold a standard deviation, in order of preference.
SIGMAS = ("sigma_z", "sigma")


def surface_options(arguments: argparse.Namespace, default: SurfaceParameters) -> SurfaceParameters:
    """Options of the surface. Raises :class:`ConfigurationError` for those that contradict one
    another.
    """
    a = arguments
    given = _vertex_options(a, default)
    relevant = relevant_option(a)
    if a.adjust != "rms-iterated" and (a.iterations is not None or a.height_tolerance is not None):
        raise ConfigurationError(
            "--iterations and --height-tolerance belong to --adjust rms-iterated", value=a.adjust
        )
    if a.exchange_last and (a.exchange == "none" or a.adjust == "none"):
        raise ConfigurationError(
            "--exchange-last is for heights that are adjusted and diagonals that are exchanged: "
            "give --exchange asd or rms, and an --adjust"
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
    return SurfaceParameters(
        **given,
        tolerance=a.tolerance,
        criterion=a.criterion,
        adjust=a.adjust,
        exchange=a.exchange,
        readjust=not a.exchange_last,
        relevant=relevant,
        window=None if a.window is None else tuple(a.window),
        duplicate_tolerance_m=a.duplicates,
        bins_per_row=a.bins,
        **{key: value for key, value in limits.items() if value is not None},
    )


def _vertex_options(a: argparse.Namespace, default: SurfaceParameters) -> dict[str, Any]:
    """Where the insertion of vertices stops: at a ratio, at a number, or by the tolerance alone."""
    if a.vertices is None:
        return {"ratio": None if a.tolerance is not None else default.ratio}
    if not a.vertices > 0 or (a.vertices > 1 and a.vertices != int(a.vertices)):
        raise ConfigurationError(
            f"--vertices {a.vertices:g}: a ratio above 0 and up to 1, or a whole number",
            value=a.vertices,
        )
    if a.vertices <= 1:
        return {"ratio": a.vertices, "vertices": None}
    return {"ratio": None, "vertices": int(a.vertices)}


def relevant_option(a: argparse.Namespace) -> str:
    """Which triangles count: as asked for, or as a limit implies."""
    relevant: str = a.relevant or (
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
    return relevant


def read_surface(path: Path, arguments: argparse.Namespace, second: bool = False) -> Source:
    """Read a file whose faces, where it has any, are the surface; in metres."""
    mesh = read_faces(path, arguments, second)
    if mesh is None:
        return read_source(path, arguments)
    mesh = mesh_in_metres(mesh, arguments)
    cloud = PointFile(mesh.vertices, dict(mesh.columns), coordinates=mesh.at or MapCoordinates())
    return Source(path, cloud, None if arguments.no_faces else mesh)


def with_sigmas_alone(source: Source) -> Source:
    """A file without the columns that tell no standard deviation: they take memory."""
    kept = {n: c for n, c in source.cloud.columns.items() if n in (*SIGMAS, "normal")}
    return dataclasses.replace(source, cloud=dataclasses.replace(source.cloud, columns=kept))


def without_places(source: Source) -> Source:
    """A file of which only the number of its points is known, and what was said of them."""
    places = np.broadcast_to(np.nan, source.cloud.r.shape)
    return dataclasses.replace(source, cloud=dataclasses.replace(source.cloud, r=places))


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
        return sigma / np.clip(
            np.nan_to_num(up), LEAST_UPWARD, 1.0
        ), "column 'sigma' along the normals"
    return sigma, f"column {name!r}"


def make_surface(
    arguments: argparse.Namespace,
    source: Source,
    options: SurfaceParameters,
    frame: Frame | None,
    sigma: float | None,
) -> CloudSurface:
    """The surface of one file, cleaned as the arguments say. Errors name it."""
    values, words = sigma_of(source, sigma, frame)
    if source.mesh is not None:
        try:
            return surface_of_mesh(
                arguments, source.mesh, source.path, options, frame, (values, words)
            )
        except SurfaceError as error:
            raise SurfaceError(
                f"{source.path}: {error}", reason=error.reason, value=error.value
            ) from error
    r = source.cloud.r if frame is None else frame.points(source.cloud.r)
    try:
        return cloud_surface(
            r,
            options,
            values,
            words,
            arguments.screen or None,
            arguments.median or None,
            arguments.clean,
        )
    except SurfaceError as error:
        raise SurfaceError(
            f"{source.path}: {error}", reason=error.reason, value=error.value
        ) from error


def surface_facts(source: Source, surface: CloudSurface) -> dict[str, Any]:
    """What the JSON says of one surface."""
    made, tin = surface.representation, surface.representation.tin
    faces = None if source.mesh is None else face_facts(source.mesh, surface)
    return {
        "path": source.path.name,
        "mesh": faces,
        "points": len(source.cloud.r),
        **cloud_facts_of(source.cloud),
        "used": len(surface.points) - made.off_map_count,
        "cropped": made.off_map_count,
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
        "fitted_points": made.fit_count,
        "rms_before_m": made.rms_before_m,
        "asd_before_m": made.asd_before_m,
        "sigma_from": surface.sigma_from,
        "sigma_held_fixed": fixed_quantities(made),
        "sigma_factor": math.sqrt(made.variance_factor),
        "sigma_point_m": None if surface.sigma_m is None else float(np.median(surface.sigma_m)),
    }


def stray_share(source: Source, surface: CloudSurface) -> float:
    """Share of the points that are strays; each counts once."""
    return len(surface.strays) / max(len(source.cloud.r) - surface.copies, 1)


def sampled_facts(made: RepresentedSurface) -> dict[str, Any] | None:
    """The area that was sampled, against the convex hull; None where it was not asked for."""
    found = made.sampled_area
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
        "beyond": found.beyond,
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
    if sampled["beyond"]:
        table.add_row("  beyond", f"{sampled['beyond']:,} points alone outside it, left out")
    if sampled["holes"]:
        table.add_row("  holes", f"{sampled['holes']} bridged, {sampled['hole_m2']:.4g} m²")
    if sampled["parts"] > 1:
        table.add_row("  parts", f"{sampled['parts']} that do not touch")


def fixed_quantities(made: RepresentedSurface) -> list[str]:
    """What the standard deviations of a surface take for given, though the noise of the points has
    a part in it.
    """
    partial = (
        ["choice of vertices"] if made.initial or len(made.tin.vertices) < made.fit_count else []
    )
    return ["triangulation", *partial, *(["exchanged diagonals"] if made.exchanges else [])]


def option_facts(options: SurfaceParameters) -> dict[str, Any]:
    """The options a surface was made with."""
    names = (
        "vertices",
        "ratio",
        "tolerance",
        "criterion",
        "adjust",
        "exchange",
        "readjust",
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

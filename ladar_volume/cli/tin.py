"""``ladar_volume tin``: a point cloud file as a triangulated surface."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import sparse

from ladar_volume.cli.inputs.mesh_source import mesh_doubts, mesh_words
from ladar_volume.cli.inputs.reading import (
    Source,
    add_reading_rows,
    carried_columns,
    clouds_of,
    reading_doubts,
)
from ladar_volume.cli.inputs.rows import read_rows
from ladar_volume.cli.outputs.tin_file_out import check_surface_output, write_as
from ladar_volume.cli.surface_options import (
    add_surface_rows,
    frame_facts,
    frame_of,
    make_surface,
    option_facts,
    read_surface,
    surface_facts,
    surface_options,
)
from ladar_volume.cli.verdict_lines import add_verdict_rows, exit_code
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.volume_verdict import counted_areas, stray_doubts, surface_doubts
from ladar_volume.io.meshfiles.tin_files import write_tin
from ladar_volume.io.pointfiles.cloud_files import check_output, write_cloud
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import ConfigurationError, OutputError
from ladar_volume.model.records import F64, I64, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.locate import interpolate_heights
from ladar_volume.tin.scan_frame import Frame
from ladar_volume.version import version


def run(arguments: argparse.Namespace) -> int:
    """Read, triangulate, write, print."""
    options = surface_options(arguments, SurfaceParameters())
    check_outputs(arguments)
    places = places_of(arguments)
    console = Console(stderr=arguments.json)
    with console.status(f"reading {arguments.cloud.name}") as status:
        source = read_surface(arguments.cloud, arguments)
        status.update("searching the scan direction" if arguments.frame == "scan" else "")
        frame = frame_of(arguments, [source])
        status.update(f"triangulating {len(source.cloud.r):,} points")
        surface = make_surface(arguments, source, options, frame, arguments.sigma)
        status.update("covariance of the heights")
        C = None if surface.sigma_m is None else surface.representation.covariance(surface.sigma_m)
        sigma_z = None if C is None else np.sqrt(C.diagonal())
        status.update("writing")
        output = write_surface(arguments, source, surface, frame, sigma_z, C)
        cleaned = write_cleaned(arguments, source, surface, frame)
    facts = {
        **surface_facts(source, surface),
        "sigma_z_median_m": None
        if sigma_z is None
        else float(np.median(sigma_z[surface.representation.tin.source >= 0])),
        "output": output,
        "cleaned": cleaned,
        "heights": height_facts(surface.representation.tin, places, C),
        "frame": frame_facts(frame),
        "options": option_facts(options),
        "version": version(),
    }
    doubts = reading_doubts(clouds_of([source]))
    doubts += mesh_doubts([source.path], [source.mesh], [surface])
    doubts += tuple(surface_verdict(facts, surface))
    facts["verdict"] = Verdict(doubts).as_dict()
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
    return exit_code(arguments, facts["verdict"])


def check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse outputs that cannot be written, and those that are one file with another."""
    check_surface_output(arguments)
    paths = [arguments.cloud, arguments.output]
    if arguments.cleaned is not None:
        paths.append(check_output(arguments.cleaned))
    if len({p.resolve() for p in paths}) < len(paths):
        words = "the cloud and the output must be different files"
        if arguments.cleaned is not None:
            words = "the cloud, the output and the cleaned cloud must be different files"
        raise OutputError(words, value=[str(p) for p in paths])


def places_of(arguments: argparse.Namespace) -> F64 | None:
    """Places (n, 2), m, whose heights are asked for; None for none."""
    if arguments.at is None:
        return None
    if arguments.frame == "scan":
        raise ConfigurationError("--at asks for heights: it goes with --frame level")
    rows = np.array(read_rows(arguments.at, "--at"))
    if rows.ndim != 2 or rows.shape[1] < 2 or not np.isfinite(rows).all():
        raise ConfigurationError(f"--at {arguments.at}: rows x y are needed, finite, in m")
    return np.ascontiguousarray(rows[:, :2])


def height_facts(
    tin: Tin, places: F64 | None, covariance: sparse.csr_array | None
) -> list[dict[str, Any]] | None:
    """Heights at places (n, 2), m, and their standard deviations, None off the surface; None where
    none is asked for.
    """
    if places is None:
        return None
    found = interpolate_heights(tin, places, covariance)
    return [
        {
            "x_m": x,
            "y_m": y,
            "height_m": None if np.isnan(z) else z,
            "sigma_m": None if np.isnan(s) or np.isnan(z) else s,
        }
        for (x, y), z, s in zip(
            places.tolist(), found.height_m.tolist(), found.sigma_m.tolist(), strict=True
        )
    ]


def write_cleaned(
    arguments: argparse.Namespace, source: Source, surface: CloudSurface, frame: Frame | None
) -> dict[str, Any] | None:
    """Write the points that the surface is made from, in the map's frame, with their attributes;
    returns what the JSON says of the file. None where it is not asked for.
    """
    path = arguments.cleaned
    if path is None:
        return None
    cloud = source.cloud
    kept, lost = carried_columns(cloud, path, ["index"])
    r = surface.points if frame is None else frame.points_to_map(surface.points)
    columns = {name: values[surface.index] for name, values in kept.items()}
    write_cloud(path, r, {**columns, "index": cloud.rows[surface.index]}, template=cloud)
    return {"path": path.name, "points": len(r), "columns_lost": lost}


def write_surface(
    arguments: argparse.Namespace,
    source: Source,
    surface: CloudSurface,
    frame: Frame | None,
    sigma_z: F64 | None,
    covariance: sparse.csr_array | None,
) -> dict[str, Any]:
    """Write the surface in the map's frame, with the standard deviations (n,), m, of its heights
    and, where the format interpolates them, by their covariance (n, n), m²; returns what the JSON
    says of the file.
    """
    path = arguments.output
    if path.suffix.lower() != ".ply":
        vertices, faces = write_as(path, source, surface, sigma_z, covariance)
        return {"path": path.name, "vertices": vertices, "faces": faces}
    tin = (
        surface.representation.tin
        if frame is None
        else frame.tin_to_map(surface.representation.tin)
    )
    vertices, faces = write_tin(
        path,
        in_cloud(tin, source.cloud.rows[surface.index]),
        sigma_z,
        arguments.all_triangles,
        source.cloud.coordinates.notes(),
    )
    return {"path": path.name, "vertices": vertices, "faces": faces}


def surface_verdict(facts: Mapping[str, Any], surface: CloudSurface) -> list[Doubt]:
    """What speaks against the surface of points: strays, and holes that were bridged."""
    if surface.given_faces is not None:
        return []
    tin = surface.representation.tin
    found = stray_doubts(facts["clean"]["strays"], facts["points"] - facts["copies"])
    return found + surface_doubts(surface, counted_areas(surface, tin.relevant))


def in_cloud(tin: Tin, index: I64) -> Tin:
    """The surface with ``source`` as rows of the file."""
    return dataclasses.replace(tin, source=np.where(tin.source >= 0, index[tin.source], -1))


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the facts as a short table."""
    table = Table(show_header=False, box=None, pad_edge=False)
    _add_surface_rows(table, facts)
    _add_fit_rows(table, facts)
    add_verdict_rows(table, facts["verdict"])
    console.print(table)
    for place in facts["heights"] or []:
        console.print(height_words(place))
    console.print(f"written to {facts['output']['path']}")
    if facts["cleaned"] is not None:
        cleaned = facts["cleaned"]
        console.print(f"{cleaned['points']:,} points written to {cleaned['path']}")


def height_words(place: Mapping[str, Any]) -> str:
    """One place and its height, as printed."""
    where = f"at {place['x_m']:.3f} {place['y_m']:.3f}"
    if place["height_m"] is None:
        return f"{where}: no surface"
    sigma = "" if place["sigma_m"] is None else f" ± {1e3 * place['sigma_m']:.2f} mm"
    return f"{where}: {place['height_m']:.4f} m{sigma}"


def _add_surface_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """Points, vertices and triangles."""
    table.add_row("points", f"{facts['points']:,} ({facts['used']:,} used)")
    add_reading_rows(table, facts)
    for name in ("cropped", "outliers", "duplicates"):
        if facts[name]:
            table.add_row(f"  {name}", f"{facts[name]:,}")
    if facts["mesh"] is not None:
        table.add_row("mesh", mesh_words(facts["mesh"]))
    else:
        add_surface_rows(table, facts)
    table.add_row("vertices", f"[bold]{facts['vertices']:,}[/bold]")
    table.add_row(
        "triangles",
        (
            f"{facts['triangles']:,} ({facts['relevant_triangles']:,} relevant, "
            f"{facts['area_m2']:.2f} m²)"
        ),
    )


def _add_fit_rows(table: Table, facts: Mapping[str, Any]) -> None:
    """How the heights were fitted, and how accurate they are."""
    if facts["adjust"] != "none":
        table.add_row(
            "heights",
            f"adjusted ({facts['adjust']}{'' if facts['converged'] else ', not converged'})",
        )
    if facts["exchanges"]:
        table.add_row("exchanged diagonals", f"{facts['exchanges']:,}")
    table.add_row(
        "fit to all points", f"RMS {1e3 * facts['rms_m']:.2f} mm, ASD {1e3 * facts['asd_m']:.2f} mm"
    )
    if facts["adjust"] != "none":
        table.add_row(
            "  as measured",
            f"RMS {1e3 * facts['rms_before_m']:.2f} mm, ASD {1e3 * facts['asd_before_m']:.2f} mm",
        )
    if facts["sigma_point_m"] is None:
        table.add_row("sigma of a point", facts["sigma_from"])
    else:
        table.add_row(
            "sigma of a point", f"{1e3 * facts['sigma_point_m']:.2f} mm ({facts['sigma_from']})"
        )
        table.add_row("sigma of a vertex", f"{1e3 * facts['sigma_z_median_m']:.2f} mm (median)")

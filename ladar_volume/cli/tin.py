"""``ladar_volume tin``: a point cloud file as a triangulated surface."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.inputs.mesh_source import mesh_doubts, mesh_words
from ladar_volume.cli.inputs.reading import Source, add_reading_rows, clouds_of, reading_doubts
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
from ladar_volume.clouds.volume_verdict import area_counted, stray_doubts, surface_doubts
from ladar_volume.io.meshfiles.tin_files import check_tin_output, write_tin
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64, I64, Tin
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.represent import SurfaceOptions
from ladar_volume.tin.scan_frame import Frame
from ladar_volume.version import version


def run(arguments: argparse.Namespace) -> int:
    """Read, triangulate, write, print."""
    options = surface_options(arguments, SurfaceOptions())
    check_tin_output(arguments.output)
    if arguments.output.resolve() == arguments.cloud.resolve():
        raise OutputError(
            "the cloud and the output must be different files", value=str(arguments.output)
        )
    console = Console(stderr=arguments.json)
    with console.status(f"reading {arguments.cloud.name}") as status:
        source = read_surface(arguments.cloud, arguments)
        status.update("searching the scan direction" if arguments.frame == "scan" else "")
        frame = frame_of(arguments, [source])
        status.update(f"triangulating {len(source.cloud.r):,} points")
        surface = make_surface(arguments, source, options, frame, arguments.sigma)
        sigma_z = None
        if surface.sigma_m is not None:
            status.update("covariance of the heights")
            sigma_z = np.sqrt(surface.made.covariance(surface.sigma_m).diagonal())
        status.update("writing")
        output = write_surface(arguments, source, surface, frame, sigma_z)
    facts = {
        **surface_facts(source, surface),
        "sigma_z_median_m": None
        if sigma_z is None
        else float(np.median(sigma_z[surface.made.tin.source >= 0])),
        "output": output,
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


def write_surface(
    arguments: argparse.Namespace,
    source: Source,
    surface: CloudSurface,
    frame: Frame | None,
    sigma_z: F64 | None,
) -> dict[str, Any]:
    """Write the surface in the map's frame, with the standard deviations (n,), m, of its heights;
    returns what the JSON says of the file.
    """
    tin = surface.made.tin if frame is None else frame.tin_back(surface.made.tin)
    vertices, faces = write_tin(
        arguments.output,
        in_cloud(tin, source.cloud.rows[surface.index]),
        sigma_z,
        arguments.all_triangles,
        source.cloud.coordinates.notes(),
    )
    return {"path": arguments.output.name, "vertices": vertices, "faces": faces}


def surface_verdict(facts: Mapping[str, Any], surface: CloudSurface) -> list[Doubt]:
    """What speaks against the surface of points: strays, and holes that were bridged."""
    if surface.given is not None:
        return []
    tin = surface.made.tin
    found = stray_doubts(facts["clean"]["strays"], facts["points"] - facts["copies"])
    return found + surface_doubts(surface, area_counted(surface, tin.relevant))


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
    console.print(f"written to {facts['output']['path']}")


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

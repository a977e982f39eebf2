"""What ``ladar_volume body`` says of its bodies, as JSON and as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.inputs.mesh_source import mesh_facts as mesh_of_file
from ladar_volume.cli.verdict_lines import add_verdict_rows
from ladar_volume.clouds.body_volume import Body, Uncertain
from ladar_volume.clouds.cloud_bodies import CloudBodies
from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.ground.objects import Objects
from ladar_volume.io.meshfiles.mesh_files import MeshFile
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.verdict import Verdict
from ladar_volume.version import version


def body_facts(body: Body) -> dict[str, Any]:
    """One body without its uncertainty."""
    skin = body.skin
    uses = np.diff(edge_table(skin.triangles)[1])
    return {
        "volume_m3": body.volume_m3,
        "uncorrected_m3": body.uncorrected_m3,
        "edge_m3": body.edge_m3,
        "curvature_m3": body.curvature_m3,
        "closed_m3": body.closed_m3,
        "area_m2": body.area_m2,
        "centroid_map_m": body.centroid_map.tolist(),
        "watertight": bool((uses == 2).all()),
        "euler": len(np.unique(skin.triangles)) - len(uses) + len(skin.triangles),
        "vertices": len(np.unique(skin.triangles)),
        "triangles": len(skin.triangles),
        "parts": len(body.closed.volumes_m3),
        "turned_triangles": int(np.count_nonzero(body.closed.flipped)),
        "crossing_pairs": body.crossing,
        "crossing_m3": body.crossed.volume_m3,
        "edge_vertices": body.edge_vertices,
        "pole_map_m": body.closed.pole_map.tolist(),
        "pole_spread_m3": body.closed.pole_spread_m3,
        "closures": [
            {
                "on": c.name,
                "size_m": c.size_m,
                "rim_vertices": c.vertices,
                "closed_m3": c.closed_m3,
                "doubt_m3": c.doubt_m3,
                "overlapping_triangles": c.overlaps,
            }
            for c in body.closures
        ],
    }


def all_facts(bodies: Sequence[Body], uncertain: Uncertain | None) -> dict[str, Any]:
    """All bodies, each and together."""
    each = [body_facts(b) for b in bodies]
    for k, facts in enumerate(each):
        facts["sigma_m3"] = None if uncertain is None else float(uncertain.sigma_m3[k])
        facts["budget_m6"] = None if uncertain is None else uncertain.budget_m6[k]
    total = {key: sum(f[key] for f in each) for key in ("volume_m3", "uncorrected_m3", "closed_m3")}
    return {
        **total,
        "sigma_m3": None if uncertain is None else float(np.sqrt(uncertain.C_m6.sum())),
        "watertight": all(f["watertight"] for f in each),
        "bodies": each,
        "covariance_m6": None if uncertain is None else uncertain.C_m6.tolist(),
        "version": version(),
    }


def mesh_facts(
    name: str, mesh: MeshFile, body: Body, uncertain: Uncertain | None
) -> dict[str, Any]:
    """The body of a mesh file."""
    source = {
        "path": name,
        "triangles": len(mesh.triangles),
        "dropped_triangles": mesh.dropped,
        **mesh_of_file(mesh),
    }
    verdict = Verdict(mesh.doubts + body.doubts).as_dict()
    return {**all_facts([body], uncertain), "input": source, "verdict": verdict}


def cloud_facts(
    name: str,
    points: int,
    filtered: CloudResult | None,
    made: CloudBodies,
    found: Objects | None,
    uncertain: Uncertain | None,
) -> dict[str, Any]:
    """The bodies of a cloud, what they stand on and how they were meshed."""
    facts = all_facts(made.bodies, uncertain)
    for k, body in enumerate(facts["bodies"]):
        body["mesh"] = {
            **made.meshes[k].report,
            "stray_triangles": made.stray[k],
            "points": len(made.sources[k]),
        }
        if found is not None:
            body["height_m"] = found.records[k].height_m
    ground = made.ground
    return {
        **facts,
        "verdict": Verdict(tuple(d for b in made.bodies for d in b.doubts)).as_dict(),
        "input": {"path": name, "points": points},
        "filter": None if filtered is None else dict(filtered.report),
        "ground": None
        if ground is None
        else {
            "origin_xy_m": ground.origin_xy.tolist(),
            "beta": ground.beta.tolist(),
            "points": len(ground.support),
            "rms_m": ground.rms_m,
        },
    }


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the bodies, where their uncertainty comes from, and what was closed."""
    table = Table(
        "body",
        "volume / m³",
        "sigma / m³",
        "uncorrected / m³",
        "closed / m³",
        "V − E + F",
        "centre",
    )
    for k, b in enumerate(facts["bodies"]):
        share = (
            ""
            if b["sigma_m3"] is None
            else f"{b['sigma_m3']:.4g} ({100 * b['sigma_m3'] / abs(b['volume_m3']):.2f} %)"
        )
        centre = ", ".join(f"{x:.2f}" for x in b["centroid_map_m"])
        table.add_row(
            str(k + 1),
            f"[bold]{b['volume_m3']:.5g}[/bold]",
            share or "not known",
            f"{b['uncorrected_m3']:.5g}",
            f"{b['closed_m3']:.3g}",
            str(b["euler"]),
            centre,
        )
    if len(facts["bodies"]) > 1:
        sigma = "not known" if facts["sigma_m3"] is None else f"{facts['sigma_m3']:.4g}"
        table.add_row(
            "all",
            f"{facts['volume_m3']:.5g}",
            sigma,
            f"{facts['uncorrected_m3']:.5g}",
            f"{facts['closed_m3']:.3g}",
            "",
            "",
        )
    console.print(table)
    for k, b in enumerate(facts["bodies"]):
        console.print(f"body {k + 1}: {details(b)}")
    if facts["sigma_m3"] is None:
        console.print("sigma is not known: give --sigma, the standard deviation of each vertex")
    verdict = Table(show_header=False, box=None, pad_edge=False)
    add_verdict_rows(verdict, facts["verdict"])
    console.print(verdict)
    console.print(
        f"watertight: {'yes' if facts['watertight'] else 'no'}; written to "
        f"{facts['output']['path']}"
    )


def details(b: Mapping[str, Any]) -> str:
    """What was made of one body, in one paragraph."""
    parts = [f"{b['triangles']:,} triangles, {b['area_m2']:.4g} m²"]
    if b["budget_m6"] is not None:
        parts.append(
            "sigma: "
            + ", ".join(
                f"{name} {variance**0.5:.2g} m³"
                for name, variance in b["budget_m6"].items()
                if variance > 0
            )
        )
    if b["edge_vertices"]:
        parts.append(f"edges completed with {b['edge_vertices']} vertices ({b['edge_m3']:+.3g} m³)")
    if b["curvature_m3"]:
        parts.append(f"curvature {b['curvature_m3']:+.3g} m³")
    for c in b["closures"]:
        where = "closed on the ground" if c["on"] == "ground" else "gap closed"
        parts.append(
            f"{where}, {c['size_m']:.3g} m ({c['closed_m3']:+.3g} m³, in doubt "
            f"{c['doubt_m3']:.2g} m³)"
        )
    if b["turned_triangles"]:
        parts.append(f"{b['turned_triangles']} triangles turned round")
    if b["crossing_pairs"]:
        parts.append(
            f"{b['crossing_pairs']} pairs of triangles cross ({b['crossing_m3']:.2g} m³ count "
            "twice or not at all)"
        )
    return "; ".join(parts)

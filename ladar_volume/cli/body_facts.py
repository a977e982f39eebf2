"""What ``ladar_volume body`` says of its bodies, as JSON and as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.inputs.mesh_source import mesh_facts as mesh_of_file
from ladar_volume.cli.verdict_lines import NO_SIGMA, add_verdict_rows
from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.body_volume import Body, Uncertain
from ladar_volume.clouds.cloud_bodies import CloudBodies, FailedBody
from ladar_volume.ground.objects import Objects
from ladar_volume.io.meshfiles.mesh_files import MeshFile
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.records import Plane
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
        "fit_m3": body.fit_m3,
        "closed_m3": body.closed_m3,
        "area_m2": body.area_m2,
        "low_m": skin.vertices[skin.triangles].min(axis=(0, 1)).tolist(),
        "high_m": skin.vertices[skin.triangles].max(axis=(0, 1)).tolist(),
        "centroid_map_m": body.centroid_map.tolist(),
        "watertight": bool((uses == 2).all()),
        "euler": len(np.unique(skin.triangles)) - len(uses) + len(skin.triangles),
        "vertices": len(np.unique(skin.triangles)),
        "triangles": len(skin.triangles),
        "parts": len(body.closed.volumes_m3),
        "turned_triangles": int(np.count_nonzero(body.closed.flipped)),
        "crossing_pairs": body.crossing_pairs,
        "crossing_m3": body.crossed_space.volume_m3,
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
        "failed": [],
        "verdict": Verdict().as_dict(),
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
    unknown = (NO_SIGMA,) if uncertain is None else ()
    verdict = Verdict(mesh.doubts + body.doubts + unknown).as_dict()
    return {**all_facts([body], uncertain), "input": source, "verdict": verdict}


def cloud_facts(
    name: str,
    points: int,
    of: BodyPoints,
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
            body["height_m"] = found.records[made.numbers[k]].height_m
    return {
        **facts,
        "failed": [failed_facts(f) for f in made.failed],
        "verdict": Verdict(tuple(d for b in made.bodies for d in b.doubts)).as_dict(),
        "input": {"path": name, "points": points},
        "filter": None if of.filtered is None else dict(of.filtered.report),
        "points": {
            "as_they_came": of.filtered is None,
            "left_out": of.left_out,
            "noise_m": of.noise_m,
        },
        "ground": None if made.ground is None else ground_facts(made.ground),
    }


def failed_facts(f: FailedBody) -> dict[str, Any]:
    """An object of which no body came."""
    return {
        "object": f.number + 1,
        "points": f.points,
        "middle_m": f.middle_m.tolist(),
        "low_m": f.low_m.tolist(),
        "high_m": f.high_m.tolist(),
        "reason": f.reason,
    }


def ground_facts(ground: Plane) -> dict[str, Any]:
    """What the bodies stand on."""
    return {
        "origin_xy_m": ground.origin_xy.tolist(),
        "beta": ground.beta.tolist(),
        "points": len(ground.support),
        "rms_m": ground.rms_m,
    }


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the bodies, where their uncertainty comes from, and what was closed."""
    table = Table("body", "volume", "sigma", "uncorrected", "closed")
    for k, b in enumerate(facts["bodies"]):
        table.add_row(str(k + 1), *volumes(b))
    for f in facts["failed"]:
        table.add_row(f"object {f['object']}", "failed", "", "", "")
    if len(facts["bodies"]) > 1:
        table.add_row("all", *volumes(facts))
    console.print(table)
    for k, b in enumerate(facts["bodies"]):
        console.print(f"body {k + 1} {place_line(b, b['centroid_map_m'])}")
        console.print(f"body {k + 1}: {details(b)}")
    for f in facts["failed"]:
        console.print(f"object {f['object']} {place_line(f, f['middle_m'])}")
    if facts.get("points", {}).get("left_out"):
        console.print(
            f"the points are taken as they came, with a noise of {facts['points']['noise_m']:.2g} m"
            f": the filter would leave out {100 * facts['points']['left_out']:.0f} % of what rises"
        )
    if facts["sigma_m3"] is None:
        console.print("sigma is not known: give --sigma, the standard deviation of each vertex")
    above = facts.get("above_ground")
    if above is not None and above["missed"]:
        console.print(
            f"{above['missed']:,} of {above['above']:,} points above the ground are in no body "
            f"({above['small']:,} clusters too small to be one)"
        )
    rows = Table(show_header=False)
    add_verdict_rows(rows, facts["verdict"])
    console.print(rows)
    console.print(
        f"watertight: {'yes' if facts['watertight'] else 'no'}; written to "
        f"{facts['output']['path']}"
    )


def place_line(b: Mapping[str, Any], middle_m: Sequence[float]) -> str:
    """Where one body is, and its extent."""
    size = [high - low for low, high in zip(b["low_m"], b["high_m"], strict=True)]
    return f"at {', '.join(f'{x:.7g}' for x in middle_m)}; {extent_text(size)}"


def extent_text(size_m: Sequence[float]) -> str:
    """Extent as length × width × height, three digits."""
    return " × ".join(f"{x:.3g}" for x in size_m) + " m"


def volumes(b: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """Volume, sigma, uncorrected and closed volume of one body."""
    volume, sigma = quantity(b["volume_m3"], b["sigma_m3"])
    share = "not known"
    if b["sigma_m3"] is not None:
        share = f"{sigma} ({100 * b['sigma_m3'] / abs(b['volume_m3']):.2g} %)"
    uncorrected = quantity(b["uncorrected_m3"], b["sigma_m3"], abs(b["volume_m3"]))[0]
    closed = quantity(b["closed_m3"], b["sigma_m3"], abs(b["volume_m3"]))[0]
    return f"[bold]{volume}[/bold]", share, uncorrected, closed


#: Units of volume, in m³, the largest first.
UNITS = (("m³", 1.0), ("L", 1e-3), ("cm³", 1e-6), ("mm³", 1e-9))


def quantity(
    value_m3: float, sigma_m3: float | None, like_m3: float | None = None
) -> tuple[str, str]:
    """A volume and its sigma in the unit that fits it (or ``like_m3``): two digits of sigma, the
    volume to the same place; five digits of the volume where sigma is not known or zero.
    """
    size = abs(value_m3) if like_m3 is None else like_m3
    unit, scale = next((u for u in UNITS if size >= 0.1 * u[1]), UNITS[-1])
    if not sigma_m3 or not np.isfinite(sigma_m3):
        return f"{value_m3 / scale:.5g} {unit}", "0"
    sigma = float(f"{sigma_m3 / scale:.1e}")
    places = 1 - int(np.floor(np.log10(sigma)))
    shown = [f"{round(x, places):,.{max(places, 0)}f} {unit}" for x in (value_m3 / scale, sigma)]
    return shown[0], shown[1]


def details(b: Mapping[str, Any]) -> str:
    """What was made of one body, in one paragraph."""
    parts = [f"{b['triangles']:,} triangles, {b['area_m2']:.4g} m², V − E + F = {b['euler']}"]
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
    if b["fit_m3"]:
        parts.append(f"surfaces off their points {b['fit_m3']:+.3g} m³")
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

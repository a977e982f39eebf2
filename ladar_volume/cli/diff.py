"""``ladar_volume diff``: the volume between two scans (or two closed meshes) by tetrahedra to a
pole.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.change.density import density, relative_errors, size_rule
from ladar_volume.change.excavation import (
    Excavation,
    Region,
    Scan,
    by_resolution,
    region_of,
)
from ladar_volume.change.ring_budget import Checked, checked_excavation
from ladar_volume.cli.diff_input import (
    Part,
    given_corners,
    icp_doubts,
    isolated_doubts,
    load,
    make_scan,
    refine_by_ground,
    sigma_of,
    without_isolated,
)
from ladar_volume.cli.diff_show import show
from ladar_volume.cli.inputs.reading import add_reading_rows, cloud_facts_of, reading_doubts
from ladar_volume.cli.verdict_lines import NO_SIGMA, exit_code
from ladar_volume.io.endings import ENDINGS
from ladar_volume.io.meshfiles.mesh_files import write_mesh
from ladar_volume.io.results import json_text
from ladar_volume.mesh.crossed_space import crossing_doubts
from ladar_volume.mesh.tetrahedra import closed_variance, closed_volume
from ladar_volume.mesh.topology import watertight
from ladar_volume.model.errors import ConfigurationError, OutputError, SurfaceError
from ladar_volume.model.verdict import Verdict
from ladar_volume.version import version

#: The doubt of a volume whose noise nobody stated.


def check_options(a: argparse.Namespace) -> None:
    """Raises :class:`ConfigurationError` for options that contradict one another,
    :class:`OutputError` for an output of unknown kind.
    """
    if (a.mass is None) != (a.mass_sigma is None):
        raise ConfigurationError("--mass and --mass-sigma go together")
    if a.polygon is not None and a.selection is not None:
        raise ConfigurationError("the region comes from --polygon or from --selection: choose one")
    if a.icp_cell is not None and a.icp is None:
        raise ConfigurationError("--icp-cell goes with --icp")
    if not a.max_edge > 0.0:
        raise ConfigurationError(f"--max-edge {a.max_edge:g}: above 0", value=a.max_edge)
    if a.output is not None and (
        a.output.suffix.lower() not in ENDINGS or not a.output.parent.is_dir()
    ):
        raise OutputError(
            f"{a.output}: no folder, or no known kind of mesh file ({', '.join(ENDINGS)})",
            value=str(a.output),
        )


def run(arguments: argparse.Namespace) -> int:
    """Read, register, compute, print."""
    check_options(arguments)
    console = Console(stderr=arguments.json)
    with console.status("reading") as status:
        a = load(arguments.a, arguments.transform, arguments, arguments.surface)
        b = load(arguments.b, arguments.transform_b, arguments, arguments.surface_b)
        # a transform brings a cloud into the other's system, whatever its own is
        clouds = [p.cloud for p in (a, b) if p.cloud is not None and p.transform is None]
        doubts = Verdict(reading_doubts(clouds))
        status.update("computing")
        if a.closed and b.closed:
            facts = bodies(arguments, a, b)
        elif a.closed or b.closed:
            raise ConfigurationError(
                "one file is a closed body and the other is not: compare two bodies or two surfaces"
            )
        else:
            facts = surfaces(arguments, a, b)
    facts["verdict"] = facts["verdict"] + doubts
    if not np.isfinite(facts["sigma_m3"]):
        facts["verdict"] = facts["verdict"] + Verdict((NO_SIGMA,))
    facts["verdict"] = facts["verdict"].as_dict()
    facts |= {"size_rule": size_rule(arguments.offset), "version": version()}
    facts["files"] = [
        {"path": p.path.name, **cloud_facts_of(p.cloud)} for p in (a, b) if p.cloud is not None
    ]
    if arguments.mass is not None:
        facts["density"] = weighed(arguments, facts)
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
        show_files(console, facts)
    return exit_code(arguments, facts["verdict"])


def show_files(console: Console, facts: dict[str, Any]) -> None:
    """Print how the clouds were read."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for each in facts["files"]:
        add_reading_rows(table, each, each["path"])
    console.print(table)


def weighed(arguments: argparse.Namespace, facts: dict[str, Any]) -> dict[str, Any]:
    """Density of what was taken away. Raises :class:`ConfigurationError` where the volume has no
    sigma.
    """
    if not np.isfinite(facts["sigma_m3"]):
        raise ConfigurationError("a density needs the volume's sigma: give --sigma")
    rho = density(arguments.mass, arguments.mass_sigma, facts["volume_m3"], facts["sigma_m3"])
    return {
        "density_kg_m3": rho.density_kg_m3,
        "sigma_kg_m3": rho.sigma_kg_m3,
        "interval_kg_m3": list(rho.interval_kg_m3),
        "coverage_factor": rho.coverage_factor,
        "variance_shares": {"mass": rho.variance_shares[0], "volume": rho.variance_shares[1]},
    }


def surfaces(arguments: argparse.Namespace, part_a: Part, part_b: Part) -> dict[str, Any]:
    """Two open surfaces: Kern's procedure. Raises :class:`ConfigurationError` without any position
    of a scanner.
    """
    eye = arguments.scanner if arguments.scanner is not None else None
    if eye is None and arguments.pole is None:
        raise ConfigurationError("from where was it scanned? Give --pole X,Y,Z or --scanner X,Y,Z")
    other = arguments.scanner_b if arguments.scanner_b is not None else eye
    a, b = (
        make_scan(part, where, arguments.pole) for part, where in ((part_a, eye), (part_b, other))
    )
    if not arguments.keep_isolated:
        part_a, part_b = without_isolated(part_a, a), without_isolated(part_b, b)
        a, b = replace(a, points=part_a.points), replace(b, points=part_b.points)
    sigma = arguments.sigma, arguments.sigma if arguments.sigma_b is None else arguments.sigma_b
    noise = [
        sigma_of(scan, part, given, arguments.beam)
        for scan, part, given in zip((a, b), (part_a, part_b), sigma, strict=True)
    ]
    a, b = (
        Scan(scan.points, scan.scanner, n.noise, scan.transform)
        for scan, n in zip((a, b), noise, strict=True)
    )
    region = region_of(
        a.points,
        given_corners(arguments.polygon, arguments.selection),
        arguments.margin,
        arguments.spacing,
    )
    more: dict[str, Any] = {}
    verdict = part_a.verdict + part_b.verdict
    verdict += Verdict(tuple(isolated_doubts((part_a, part_b))))
    if arguments.icp is not None:
        before = b
        b, more["icp"] = refine_by_ground(a, b, region, arguments.icp, arguments.icp_cell)
        verdict += Verdict(tuple(icp_doubts(more["icp"], before)))
    checked = checked_excavation(
        a,
        b,
        region,
        arguments.ring_correction,
        pole_map=arguments.pole,
        max_edge_m=arguments.max_edge,
    )
    found, b = checked.found, checked.b
    verdict += checked.verdict
    if arguments.output is not None:
        write_mesh(arguments.output, found.between.vertices, found.between.triangles, ["metres"])
    if arguments.resolution is not None:
        s = by_resolution(a, b, region, arguments.resolution, arguments.max_edge)
        names = ("cell_m", "points", "volume_m3", "area_m2")
        more["resolution"] = {n: getattr(s, n).tolist() for n in names} | {
            "dimension": s.dimension,
            "volume_change_m3": s.volume_change_m3,
        }
    if arguments.published:
        more["published_m3"] = found.published_m3
    points = [
        {
            "path": p.path.name,
            "points": len(p.points),
            "in_region": int(m.sum()),
            "sigma_m": n.typical_m,
            "sigma_from": n.words,
            "isolated": p.isolated,
        }
        for p, m, n in zip((part_a, part_b), (found.in_a, found.in_b), noise, strict=True)
    ]
    facts = facts_of(found, region, noise[0].typical_m, arguments.offset)
    facts["ring"] |= ring_facts(checked)
    return facts | {"surfaces": points, "verdict": verdict} | more


def ring_facts(checked: Checked) -> dict[str, Any]:
    """What the ring says of the registration, as plain values: before any correction."""
    fit = checked.fit
    return {
        "offset_m": fit.offset_m,
        "offset_sigma_m": fit.offset_sigma_m,
        "tilt_rad": fit.tilt_rad,
        "effect_m3": fit.effect_m3,
        "effect_sigma_m3": fit.effect_sigma_m3,
        "scatter_m": fit.scatter_m,
        "changed_share": fit.changed_share,
        "correction": checked.correction,
    }


def facts_of(found: Excavation, region: Region, noise_m: float, offset_m: float) -> dict[str, Any]:
    """The result as plain values."""
    d, V = found.between, abs(found.removed_m3)
    plan = d.area_a_m2
    height = (
        float(np.sqrt(sum(v for k, v in found.budget_m6.items() if k.startswith("registration"))))
        / plan
    )
    spacing = float(
        np.sqrt((d.area_a_m2 + d.area_b_m2) / max(int(found.in_a.sum() + found.in_b.sum()), 1))
    )
    noise_m = noise_m if np.isfinite(noise_m) else 0.0
    return {
        "method": "two surfaces and a pole",
        "volume_m3": found.removed_m3,
        "sigma_m3": found.sigma_m3,
        "budget_m6": found.budget_m6,
        "interval_m3": [
            found.removed_m3 - 1.96 * found.sigma_m3,
            found.removed_m3 + 1.96 * found.sigma_m3,
        ],
        "coverage_factor": 1.96,
        "watertight": watertight(d.triangles),
        "closed_m3": found.closed_m3,
        "bridged_m2": list(d.bridged_m2),
        "area_m2": found.area_m2,
        "area_a_m2": d.area_a_m2,
        "area_b_m2": d.area_b_m2,
        "pole_m": d.pole_map.tolist(),
        "pole_spread_m3": d.pole_spread_m3,
        "ring": {
            "points": len(d.gap_m),
            "mean_gap_m": float(d.gap_m.mean()),
            "rms_gap_m": float(np.sqrt((d.gap_m**2).mean())),
            "largest_gap_m": float(np.abs(d.gap_m).max()),
        },
        "region": {
            "corners_m": region.corners.tolist(),
            "margin_m": region.margin_m,
            "spacing_m": region.spacing_m,
        },
        "size_classes": None
        if V == 0.0
        else relative_errors(
            found.area_m2,
            V,
            offset_m=offset_m,
            noise_m=noise_m,
            spacing_m=spacing,
            height_m=height,
            plan_area_m2=plan,
        ),
    }


def bodies(arguments: argparse.Namespace, a: Part, b: Part) -> dict[str, Any]:
    """Two closed meshes: the difference of their volumes. Raises :class:`ConfigurationError` for
    options of scans.
    """
    for name in ("polygon", "selection", "icp", "resolution", "output", "scanner", "scanner_b"):
        if getattr(arguments, name) is not None:
            raise ConfigurationError(
                f"--{name.replace('_', '-')} is for scans; these are closed bodies"
            )
    sigmas = arguments.sigma, arguments.sigma if arguments.sigma_b is None else arguments.sigma_b
    budget: dict[str, float] = {}
    volumes, spread, area, points, closed = [], 0.0, 0.0, 0, []
    verdict = a.verdict + b.verdict
    for name, part, sigma in zip("ab", (a, b), sigmas, strict=True):
        try:
            body = closed_volume(
                part.points, part.triangles, arguments.pole, arguments.allow_crossings
            )
        except SurfaceError as error:
            raise SurfaceError(
                f"{part.path}: {error}", reason=error.reason, value=error.value
            ) from error
        variance = closed_variance(part.points, body, sigma or 0.0)
        budget[f"noise_{name}"] = (
            np.nan if sigma is None else variance.first_m6 + variance.second_m6
        )
        if part.transform is not None:
            budget[f"registration_{name}"] = part.transform.variance(
                body.gradient, part.transform.back(part.points)
            )
        if body.crossing is not None:
            verdict += Verdict(crossing_doubts(body.crossing, body.volume_m3))
        volumes.append(body.volume_m3)
        spread, area, points = (
            max(spread, body.pole_spread_m3),
            area + body.area_m2,
            points + body.mesh.vertices,
        )
        closed.append(
            {
                "path": part.path.name,
                "volume_m3": body.volume_m3,
                "area_m2": body.area_m2,
                "parts": len(body.volumes_m3),
                "turned_triangles": int(body.flipped.sum()),
                "crossing_m3": 0.0 if body.crossing is None else body.crossing.volume_m3,
            }
        )
    volume, sigma = volumes[0] - volumes[1], float(np.sqrt(sum(budget.values())))
    return {
        "method": "closed bodies",
        "volume_m3": volume,
        "sigma_m3": sigma,
        "budget_m6": budget,
        "watertight": True,
        "closed_m3": 0.0,
        "interval_m3": [volume - 1.96 * sigma, volume + 1.96 * sigma],
        "coverage_factor": 1.96,
        "area_m2": area,
        "pole_m": body.pole_map.tolist(),
        "pole_spread_m3": spread,
        "bodies": closed,
        "verdict": verdict,
        "size_classes": None
        if volume == 0.0
        else relative_errors(
            area,
            abs(volume),
            offset_m=arguments.offset,
            noise_m=max(s or 0.0 for s in sigmas),
            spacing_m=float(np.sqrt(area / points)),
        ),
    }

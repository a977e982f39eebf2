"""``ladar_volume diff``: the volume between two scans (or two closed meshes) by tetrahedra to a
pole.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
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
from ladar_volume.change.ring_budget import RingCheck, checked_excavation
from ladar_volume.cli.diff_bodies import bodies
from ladar_volume.cli.diff_input import (
    Noise,
    ScanFile,
    given_corners,
    icp_doubts,
    isolated_doubts,
    load,
    make_scan,
    refine_by_ground,
    sigma_of,
    without_isolated,
)
from ladar_volume.cli.inputs.reading import add_reading_rows, cloud_facts_of, reading_doubts
from ladar_volume.cli.tables.diff_table import show
from ladar_volume.cli.verdict_lines import NO_SIGMA, exit_code
from ladar_volume.io.endings import ENDINGS
from ladar_volume.io.meshfiles.mesh_files import write_mesh
from ladar_volume.io.results import json_text
from ladar_volume.mesh.topology import watertight
from ladar_volume.model.errors import ConfigurationError, OutputError
from ladar_volume.model.records import F64, Bool
from ladar_volume.model.verdict import Verdict
from ladar_volume.version import version


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
        facts["density"] = density_facts(arguments, facts)
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


def density_facts(arguments: argparse.Namespace, facts: dict[str, Any]) -> dict[str, Any]:
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


@dataclass(frozen=True)
class NoisyScan:
    """A scan ready for the volume: its file without the returns that stand alone, the scan with its
    noise, and where that noise comes from.
    """

    file: ScanFile
    scan: Scan
    noise: Noise


def surfaces(arguments: argparse.Namespace, file_a: ScanFile, file_b: ScanFile) -> dict[str, Any]:
    """Two open surfaces: Kern's procedure. Raises :class:`ConfigurationError` without any position
    of a scanner.
    """
    first, second = noisy_scans(arguments, file_a, file_b)
    a, b = first.scan, second.scan
    corners = given_corners(arguments.polygon, arguments.selection)
    region = region_of(a.points, corners, arguments.margin, arguments.spacing)
    more: dict[str, Any] = {}
    verdict = first.file.verdict + second.file.verdict
    verdict += Verdict(tuple(isolated_doubts((first.file, second.file))))
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
    found = checked.excavation
    if arguments.output is not None:
        write_mesh(arguments.output, found.between.vertices, found.between.triangles, ["metres"])
    if arguments.resolution is not None:
        more["resolution"] = resolution_facts(arguments, a, checked.b, region)
    if arguments.published:
        more["published_m3"] = found.published_m3
    facts = facts_of(found, region, first.noise.typical_m, arguments.offset)
    facts["ring"] |= ring_facts(checked)
    scans = [scan_facts(first, found.in_a), scan_facts(second, found.in_b)]
    return facts | {"surfaces": scans, "verdict": verdict + checked.verdict} | more


def noisy_scans(
    arguments: argparse.Namespace, file_a: ScanFile, file_b: ScanFile
) -> tuple[NoisyScan, NoisyScan]:
    """Both scans with their noise. Raises :class:`ConfigurationError` without any position of a
    scanner.
    """
    eye_a = arguments.scanner
    if eye_a is None and arguments.pole is None:
        raise ConfigurationError("from where was it scanned? Give --pole X,Y,Z or --scanner X,Y,Z")
    eye_b = eye_a if arguments.scanner_b is None else arguments.scanner_b
    sigma_b = arguments.sigma if arguments.sigma_b is None else arguments.sigma_b
    return (
        noisy_scan(arguments, file_a, eye_a, arguments.sigma),
        noisy_scan(arguments, file_b, eye_b, sigma_b),
    )


def noisy_scan(
    arguments: argparse.Namespace, file: ScanFile, eye: F64 | None, sigma: float | None
) -> NoisyScan:
    """One scan from its scanner's position (3,), m, in the file's frame, with its noise, m, or what
    the file says of it.
    """
    scan = make_scan(file, eye, arguments.pole)
    if not arguments.keep_isolated:
        file = without_isolated(file, scan)
        scan = replace(scan, points=file.points)
    noise = sigma_of(scan, file, sigma, arguments.beam)
    return NoisyScan(file, replace(scan, noise=noise.noise), noise)


def resolution_facts(
    arguments: argparse.Namespace, a: Scan, b: Scan, region: Region
) -> dict[str, Any]:
    """Volume and surface of clouds thinned to cells."""
    s = by_resolution(a, b, region, arguments.resolution, arguments.max_edge)
    names = ("cell_m", "points", "volume_m3", "area_m2")
    return {n: getattr(s, n).tolist() for n in names} | {
        "dimension": s.dimension,
        "volume_change_m3": s.volume_change_m3,
    }


def scan_facts(scan: NoisyScan, in_region: Bool) -> dict[str, Any]:
    """What the JSON says of one scan."""
    return {
        "path": scan.file.path.name,
        "points": len(scan.file.points),
        "in_region": int(in_region.sum()),
        "sigma_m": scan.noise.typical_m,
        "sigma_from": scan.noise.words,
        "isolated": scan.file.isolated_count,
    }


def ring_facts(checked: RingCheck) -> dict[str, Any]:
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
    d = found.between
    half = 1.96 * found.sigma_m3
    return {
        "method": "two surfaces and a pole",
        "volume_m3": found.removed_m3,
        "sigma_m3": found.sigma_m3,
        "budget_m6": found.budget_m6,
        "interval_m3": [found.removed_m3 - half, found.removed_m3 + half],
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
        "size_classes": size_classes(found, noise_m, offset_m),
    }


def size_classes(found: Excavation, noise_m: float, offset_m: float) -> dict[str, float] | None:
    """Each class of error as a share of the volume; None for a volume of zero."""
    d, volume = found.between, abs(found.removed_m3)
    plan = d.area_a_m2
    height = (
        float(np.sqrt(sum(v for k, v in found.budget_m6.items() if k.startswith("registration"))))
        / plan
    )
    spacing = float(
        np.sqrt((d.area_a_m2 + d.area_b_m2) / max(int(found.in_a.sum() + found.in_b.sum()), 1))
    )
    if volume == 0.0:
        return None
    return relative_errors(
        found.area_m2,
        volume,
        offset_m=offset_m,
        noise_m=noise_m if np.isfinite(noise_m) else 0.0,
        spacing_m=spacing,
        height_m=height,
        plan_area_m2=plan,
    )

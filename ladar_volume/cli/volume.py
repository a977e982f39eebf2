"""``ladar_volume volume``: cut and fill of a point cloud file above a base, or between two of
them.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from statistics import NormalDist
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
from ladar_volume.clouds.cloud_levels import (
    above_floor,
    events,
    folded_levels,
    level_list,
    sequence,
)
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume, above_base, between_clouds, own_footprints
from ladar_volume.clouds.ground_readings import ground_readings
from ladar_volume.clouds.volume_verdict import (
    area_counted,
    judged,
    places,
    stray_doubts,
    surface_doubts,
)
from ladar_volume.io.config import read_config
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import ConfigurationError, LadarVolumeError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Bool, Plane
from ladar_volume.model.verdict import Verdict
from ladar_volume.tin.represent import SurfaceOptions
from ladar_volume.tin.scan_frame import Frame
from ladar_volume.version import version
from ladar_volume.volume.floors import surface_offset
from ladar_volume.volume.published_methods import zero_fill_level

#: Parameters that options of their own give.
OWN_OPTION = {
    "base": "--base",
    "level_m": "--level",
    "plane": "--plane",
    "relevant": "--relevant",
    "max_edge_m": "--max-edge",
    "max_circumdiameter_m": "--max-circle",
    "vertex_ratio": "--vertices",
}


def parameters_of(arguments: argparse.Namespace) -> tuple[Parameters, str]:
    """Parameters of base, outline and ground, and the base: "level", "plane", "ground", "floor",
    "cloud" (the second one), or "lowest" (the highest level without fill). Raises
    :class:`ConfigurationError` for options that contradict one another.
    """
    a, two = arguments, arguments.cloud_b is not None
    inferred = (
        "plane"
        if a.plane is not None
        else "level"
        if a.level is not None
        else "floor"
        if a.levels is not None
        else ""
    )
    if two and a.footprint == "common":
        if a.level is not None or a.plane is not None or a.base is not None:
            raise ConfigurationError(
                "the second cloud is the base; a level or a plane goes with --footprint own"
            )
        return _read(a, "cloud"), "cloud"
    if not two and (a.footprint == "own" or a.sigma_b is not None):
        raise ConfigurationError("--footprint own and --sigma-b are for two clouds")
    base = a.base or ("lowest" if two and inferred in ("floor", "") else inferred)
    if not base:
        raise ConfigurationError(
            "above what? Give --level Z, --base plane, ground or floor, or a second cloud"
        )
    for name, value in (("level", a.level), ("plane", a.plane)):
        if (base == name) != (value is not None):
            raise ConfigurationError(f"--base {name} and --{name} go together", value=base)
    if base == "floor" and (a.levels is None or two):
        raise ConfigurationError("--base floor needs --levels START STOP STEP, and one cloud")
    if base == "ground" and (a.frame == "scan" or two):
        raise ConfigurationError("--base ground is for one cloud in the level frame")
    return _read(a, base), base


def _read(a: argparse.Namespace, base: str) -> Parameters:
    keys = [text.partition("=")[0].strip() for text in a.set]
    for key in keys:
        section, _, name = key.partition(".")
        if section not in ("volume", "ground"):
            raise ConfigurationError(
                f"--set {key}: this verb has parameters of the sections 'volume' and 'ground' only",
                value=key,
            )
        if section == "volume" and name in OWN_OPTION:
            raise ConfigurationError(f"--set {key}: use {OWN_OPTION[name]}", value=key)
    start = read_config(None, a.set)
    chosen = a.outline or (
        start.volume.outline if "volume.outline" in keys else "auto" if base == "ground" else "all"
    )
    if base == "cloud" and chosen != "all":
        raise ConfigurationError(
            (
                "between two clouds the volume counts over their whole common footprint; "
                "crop with --window"
            ),
            value=chosen,
        )
    volume = dataclasses.replace(
        start.volume, base="ground" if base == "ground" else "level", outline=chosen
    )
    if base == "level":
        volume = dataclasses.replace(volume, level_m=a.level)
    if base == "plane":
        volume = dataclasses.replace(volume, base="plane", plane=tuple(a.plane))
    return dataclasses.replace(start, volume=volume)


def run(arguments: argparse.Namespace) -> int:
    """Read, triangulate, compute, print."""
    (parameters, base), options = (
        parameters_of(arguments),
        surface_options(arguments, SurfaceOptions(ratio=1.0)),
    )
    sigmas = (arguments.sigma, arguments.sigma if arguments.sigma_b is None else arguments.sigma_b)
    levels = None if arguments.levels is None else level_list(*arguments.levels)
    console = Console(stderr=arguments.json)
    with console.status("reading") as status:
        sources = [
            read_surface(path, arguments, second)
            for path, second in ((arguments.cloud, False), (arguments.cloud_b, True))
            if path is not None
        ]
        doubts = reading_doubts(clouds_of(sources))
        if arguments.frame == "scan":
            status.update("turning into the scan frame")
        frame = frame_of(arguments, sources)
        surfaces = []
        for source, sigma in zip(sources, sigmas, strict=False):
            status.update(f"triangulating {len(source.cloud.r):,} points of {source.path.name}")
            surfaces.append(make_surface(arguments, source, options, frame, sigma))
        status.update("cut and fill")
        facts, volume = computed(arguments, surfaces, parameters, base, levels, frame)
        strays = sum(len(s.strays) for s in surfaces)
        with_all, why = None, ""
        if strays:
            status.update("the same with the points that were left out")
            with_all, why = effect_of_strays(
                arguments, sources, options, parameters, base, levels, frame
            )
    points = sum(len(s.cloud.r) for s in sources) - sum(s.copies for s in surfaces)
    doubts += mesh_doubts([s.path for s in sources], [s.mesh for s in sources], surfaces)
    doubts += tuple(stray_doubts(strays, points))
    facts["verdict"] = (Verdict(doubts) + facts.pop("verdict")).as_dict()
    facts |= {
        "clean": {
            "how": arguments.clean,
            "strays": strays,
            "share": strays / max(points, 1),
            "effect_m3": None if with_all is None else volume.net_m3 - with_all,
            "why": why or None,
        },
        "surfaces": [
            surface_facts(source, surface)
            for source, surface in zip(sources, surfaces, strict=True)
        ],
        "frame": frame_facts(frame),
        "options": option_facts(options),
        "version": version(),
    }
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
    return exit_code(arguments, facts["verdict"])


def computed(
    a: argparse.Namespace,
    surfaces: list[CloudSurface],
    parameters: Parameters,
    base: str,
    levels: F64 | None,
    frame: Frame | None,
) -> tuple[dict[str, Any], CloudVolume]:
    """The volume with its verdict, and where levels are asked for the sequence with its floors."""
    correct = not a.no_correction
    more: dict[str, Any] = {}
    parameters = in_frame(a, surfaces, parameters, base, frame)
    volume, parameters, counted, masks, each = answer(surfaces, parameters, base, levels, correct)
    if each:
        more["each"] = [volume_facts(v, parameters) for v in each]
    if base == "cloud":
        volume = dataclasses.replace(
            volume, base=f"surface of {second_name(a)} over the common footprint"
        )
    if base == "plane" and frame is not None:
        volume = dataclasses.replace(
            volume, base="given plane z = {:.6g} + {:.6g} x + {:.6g} y".format(*a.plane)
        )
    verdict, areas = Verdict(), [area_counted(s, m) for s, m in zip(surfaces, masks, strict=True)]
    if len(surfaces) == 1 and surfaces[0].given is None:
        readings = None
        if base == "ground" and counted is not None:
            readings = ground_readings(surfaces[0], counted, areas[0], parameters)
        by_body = parameters.volume.outline == "auto"
        volume, verdict = judged(volume, surfaces[0], areas[0], readings, by_body, counted)
        more["readings"] = None if readings is None else dataclasses.asdict(readings)
    else:
        sampled = [(s, a) for s, a in zip(surfaces, areas, strict=True) if s.given is None]
        for surface, area in sampled:  # a mesh has no sampling
            verdict += Verdict(tuple(surface_doubts(surface, area)))
    more["outline_parts"] = [dataclasses.asdict(p) for p in places(surfaces[0], areas[0])]
    facts = volume_facts(volume, parameters)
    if levels is not None:
        more |= level_facts(surfaces, levels, None if base == "level" else counted, correct)
    facts |= {"footprint": a.footprint if len(surfaces) == 2 else None, **more}
    return {**facts, "verdict": verdict}, volume


def in_frame(
    a: argparse.Namespace,
    surfaces: list[CloudSurface],
    parameters: Parameters,
    base: str,
    frame: Frame | None,
) -> Parameters:
    """The parameters with a given plane in the frame of the surfaces, and the lowest level."""
    if base == "plane" and frame is not None:
        turned = tuple(frame.plane(np.array(a.plane)).tolist())
        return dataclasses.replace(
            parameters, volume=dataclasses.replace(parameters.volume, plane=turned)
        )
    if base == "lowest":
        level = zero_fill_level(surfaces[0].made.tin, surfaces[1].made.tin)
        return dataclasses.replace(
            parameters, volume=dataclasses.replace(parameters.volume, level_m=level)
        )
    return parameters


def answer(
    surfaces: list[CloudSurface],
    parameters: Parameters,
    base: str,
    levels: F64 | None,
    correct: bool,
) -> tuple[CloudVolume, Parameters, Plane | None, list[Bool], list[CloudVolume]]:
    """The volume, the parameters with the floor where that is the base, the base from which levels
    count, the triangles of each surface that count, and where each has a volume of its own these.
    """
    first, masks = surfaces[0], [s.made.tin.relevant for s in surfaces]
    if base == "cloud":
        return (
            between_clouds(first, surfaces[1], "the second", correct),
            parameters,
            None,
            masks,
            [],
        )
    if len(surfaces) == 2:
        volume, one, two = own_footprints(first, surfaces[1], parameters, correct)
        return volume, parameters, None, masks, [one, two]
    if base == "floor" and levels is not None:
        volume, parameters = above_floor(first, sequence(first, levels), parameters, correct)
        return volume, parameters, None, masks, []
    volume, found, mask = above_base(first, parameters, correct)
    return volume, parameters, found, [mask], []


def effect_of_strays(
    a: argparse.Namespace,
    sources: list[Source],
    options: SurfaceOptions,
    parameters: Parameters,
    base: str,
    levels: F64 | None,
    frame: Frame | None,
) -> tuple[float | None, str]:
    """The net volume, m³, with the points that were left out; None, and why, for none."""
    try:
        raw = [make_surface(a, s, options, frame, 0.0, "off") for s in sources]
        own = in_frame(a, raw, parameters, base, frame)
        return answer(raw, own, base, levels, False)[0].net_m3, ""
    except LadarVolumeError as error:
        return None, str(error)


def second_name(a: argparse.Namespace) -> str:
    """What the second surface is called."""
    name = str(a.cloud_b.name)
    return name if a.surface_b is None else f"{a.surface_b} in {name}"


def volume_facts(volume: CloudVolume, parameters: Parameters) -> dict[str, Any]:
    """What the JSON says of a volume."""
    k = NormalDist().inv_cdf(0.5 + parameters.volume.confidence / 2)
    half = k * volume.sigma_m3
    return {
        "cut_m3": volume.cut_m3,
        "fill_m3": volume.fill_m3,
        "net_m3": volume.net_m3,
        "sigma_m3": volume.sigma_m3,
        "interval_m3": [volume.net_m3 - half, volume.net_m3 + half],
        "confidence": parameters.volume.confidence,
        "coverage_factor": k,
        "sigma_cut_m3": volume.sigma_cut_m3,
        "sigma_fill_m3": volume.sigma_fill_m3,
        "area_m2": volume.area_m2,
        "base": volume.base,
        "base_same_survey": volume.base_same_survey,
        "correction": {
            "name": "folded normal" if abs(volume.folded_m3) > 0.0 else None,
            "m3": volume.folded_m3,
            "near_area_m2": volume.near_area_m2,
            "cut_raw_m3": volume.cut_raw_m3,
            "fill_raw_m3": volume.fill_raw_m3,
        },
        "budget_m6": volume.budget_m6,
        "sigma_holds": "noise of the points and what lies between them only",
        "centimetre_m3": 0.01 * volume.area_m2,
    }


def level_facts(
    surfaces: list[CloudSurface], levels: F64, base: Plane | None, correct: bool
) -> dict[str, Any]:
    """Sequences, events and, for two clouds, the offset between their sequences. Cut and fill are
    corrected near the levels where that is wanted and the noise is known.
    """
    out, found = [], [sequence(s, levels, base) for s in surfaces]
    for surface, each in zip(surfaces, found, strict=True):
        seen, sigma = events(surface, each, base)
        folded = folded_levels(surface, each, base) if correct else np.zeros(len(levels))
        taken = np.nan_to_num(folded)
        out.append(
            {
                "level_m": each.level_m.tolist(),
                "cut_m3": (each.cut_m3 - taken).tolist(),
                "fill_m3": (each.fill_m3 - taken).tolist(),
                "folded_m3": folded.tolist(),
                "above_m2": each.above_m2.tolist(),
                "first_m3": np.diff(each.cut_m3).tolist(),
                "second_m3": np.diff(each.cut_m3, 2).tolist(),
                "events": [
                    {"level_m": e.level_m, "sigma_m": s, "area_m2": e.area_m2, "width_m": e.width_m}
                    for e, s in zip(seen, sigma.tolist(), strict=True)
                ],
                "floor_m": seen[0].level_m if seen else None,
                "top_m": seen[-1].level_m if seen else None,
            }
        )
    facts: dict[str, Any] = {
        "sequences": out,
        "levels_from": "the base" if base is not None else "zero height of the frame",
    }
    if len(surfaces) == 2:
        try:
            offset = surface_offset(surfaces[0].made.tin, surfaces[1].made.tin, levels)
            facts["offset"] = {
                "offset_m": offset.offset_m,
                "sigma_m": offset.sigma_m,
                "levels": offset.levels,
            }
        except VolumeError as error:
            facts["offset"] = {"offset_m": None, "why": str(error)}
    return facts


def show(console: Console, facts: Mapping[str, Any]) -> None:
    """Print the facts as short tables."""
    k, (low, high), fix = facts["coverage_factor"], facts["interval_m3"], facts["correction"]
    known = bool(np.isfinite(facts["sigma_m3"]))
    table = Table(show_header=False, box=None, pad_edge=False)
    spread = (
        f" ± {facts['sigma_m3']:.4f} m³[/bold] (1 sigma, noise only)" if known else " m³[/bold]"
    )
    table.add_row("net volume", f"[bold]{facts['net_m3']:.4f}{spread}")
    if known:
        table.add_row(
            f"{100 * facts['confidence']:.0f} % interval",
            f"{low:.4f} to {high:.4f} m³ (k = {k:.2f})",
        )
    for name in ("cut", "fill"):
        table.add_row(
            name,
            f"{facts[f'{name}_m3']:.4f}"
            + (f" ± {facts[f'sigma_{name}_m3']:.4f} m³" if known else " m³"),
        )
    table.add_row(
        "not in it",
        f"what all points share; 1 cm of height is {facts['centimetre_m3']:.4g} m³",
    )
    table.add_row("area", f"{facts['area_m2']:.3f} m²")
    for part in facts["outline_parts"][:5]:
        x0, y0, x1, y1 = part["extent_m"]
        table.add_row(
            "  at",
            f"{part['x_m']:.2f} {part['y_m']:.2f}, {x1 - x0:.4g} m by {y1 - y0:.4g} m, heights "
            f"{part['bottom_m']:.3f} to {part['top_m']:.3f} m",
        )
    table.add_row("above", facts["base"] + (" (same survey)" if facts["base_same_survey"] else ""))
    if fix["name"]:
        words = (
            f"{fix['m3']:.4f} m³ taken from cut and from fill over {fix['near_area_m2']:.2f} "
            "m² near the base"
        )
        table.add_row("corrected", f"{words} ({fix['name']})")
    for each in facts["surfaces"]:
        sigma = "" if each["sigma_point_m"] is None else f"{1e3 * each['sigma_point_m']:.2f} mm, "
        table.add_row(
            each["path"],
            (
                f"{each['used']:,} points, {each['vertices']:,} vertices; sigma "
                f"{sigma}{each['sigma_from']}"
            ),
        )
        if each["mesh"] is not None:
            table.add_row("", mesh_words(each["mesh"]))
        else:
            add_reading_rows(table, each)
            add_surface_rows(table, each)
    clean = facts["clean"]
    if clean["effect_m3"] is not None:
        table.add_row(
            "without strays", f"{clean['effect_m3']:+.4f} m³ against all points (--clean off)"
        )
    elif clean["strays"]:
        table.add_row("with strays", f"no volume: {clean['why']}".replace("[", r"\["))
    add_verdict_rows(table, facts["verdict"])
    console.print(table)
    for each in facts.get("sequences", []):
        show_levels(console, each)
    if "offset" in facts and facts["offset"]["offset_m"] is not None:
        console.print(f"offset of the sequences {1e3 * facts['offset']['offset_m']:.2f} mm")


def show_levels(console: Console, each: Mapping[str, Any], most: int = 20) -> None:
    """Print at most ``most`` levels, evenly spread, and the events."""
    table = Table("level / m", "cut / m³", "fill / m³", "area above / m²")
    count = len(each["level_m"])
    for i in np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)).tolist():
        table.add_row(
            *(f"{each[name][i]:.4f}" for name in ("level_m", "cut_m3", "fill_m3", "above_m2"))
        )
    console.print(table)
    for event in each["events"]:
        sigma = event["sigma_m"]
        spread = f" ± {1e3 * sigma:.2f} mm" if np.isfinite(sigma) else ""
        console.print(f"flat part at {event['level_m']:.4f} m{spread}, {event['area_m2']:.3f} m²")

"""``ladar_volume tiles``: the volume of a cloud larger than the memory."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable
from typing import Any

from rich.console import Console

from ladar_volume.cli.inputs.base_choice import parameters_of
from ladar_volume.cli.inputs.reading import reading_of
from ladar_volume.cli.scale.workers import Progress, check_workers, progress_on, workers_of
from ladar_volume.cli.surface_options import relevant_option
from ladar_volume.cli.tables.volume_table import show
from ladar_volume.cli.verdict_lines import NO_SIGMA, exit_code
from ladar_volume.cli.volume_facts import volume_facts
from ladar_volume.clouds.sampling.site_lengths import length_facts, named_lengths
from ladar_volume.clouds.volume_verdict import stray_doubts
from ladar_volume.io.results import MOST_OBJECTS, json_text
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tiles.cleaning.cleaned_tiles import CleanedTiles
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_surface import Limits
from ladar_volume.tiles.tiled_volume import TiledVolume, VolumeTask, volume_by_tiles
from ladar_volume.version import version

#: Options of ``volume`` that tiles know.
SHARED = frozenset(
    "verb run cloud json strict quiet crs units classes level plane base outline set ground_preset "
    "clean no_correction relevant max_edge max_circle sigma tile store dask workers".split()
)


def run(arguments: argparse.Namespace) -> int:
    """Deal out, triangulate, add up, print."""
    refuse_unknown_options(arguments)
    console, words = Console(stderr=arguments.json), Console(stderr=True)
    parameters = requested_parameters(arguments)
    store = arguments.store or arguments.cloud.with_name(arguments.cloud.name + ".tiles")
    with words.status("reading"):
        cloud = parts_of_file(arguments.cloud, store, arguments.tile, reading_of(arguments))
    with workers_of(arguments, words) as workers, progress_on(words) as bars:
        named, correct = named_lengths(arguments.set), not arguments.no_correction
        limits, clean = limits_of(arguments), arguments.clean == "auto"
        task = VolumeTask(limits, parameters, arguments.sigma, correct, named=named, clean=clean)
        found = volume_by_tiles(cloud, task, workers, shares(bars))
    facts = facts_of(found, arguments)
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
        at = facts["tiles"]
        console.print(
            f"{at['points']:,} points, {at['vertices']:,} vertices, {at['triangles']:,} triangles "
            f"in {at['count']:,} tiles of {at['side_m']:g} m, at rest in {at['folder']}"
        )
        alone = {"alone beyond what was sampled": at["alone"], "strays": facts["clean"]["strays"]}
        for why, count in (at["left_out"] | alone).items():
            if count:
                console.print(f"left out: {count:,} {why}")
    return exit_code(arguments, facts["verdict"])


def requested_parameters(a: argparse.Namespace) -> Parameters:
    """The parameters that are asked for. Raises :class:`ConfigurationError`."""
    if a.sigma is not None and a.sigma < 0.0:
        raise ConfigurationError(f"--sigma {a.sigma:g}: 0 or more", value=a.sigma)
    check_workers(a)
    if a.clean == "filter":
        raise ConfigurationError("--clean filter is not done by tiles: auto or off", value=a.clean)
    if a.base not in (None, "level", "plane", "ground"):
        words = f"--base {a.base} is not told by tiles: level, plane or ground"
        raise ConfigurationError(words, value=a.base)
    parameters, base = parameters_of(a)
    outline = parameters.volume.outline
    if parameters.volume.names_plants:
        words = "volume.ground_cover_m and body_cover_m are not told by tiles: leave them out"
        raise ConfigurationError(words)
    if outline != "all" and (outline == "polygon" or base != "ground"):
        words = f"the outline {outline} above a {base} is not told by tiles: --outline all"
        raise ConfigurationError(words, value=outline)
    return parameters


def limits_of(a: argparse.Namespace) -> Limits:
    """Which triangles count. Raises :class:`ConfigurationError`."""
    relevant = relevant_option(a)
    if relevant == "corners":  # there are no artificial ones
        relevant = "all"
    return Limits(relevant, a.max_edge or math.inf, a.max_circle or math.inf)


def shares(progress: Progress) -> Callable[[str, int, int], None]:
    """Progress in points of a stage."""
    done: dict[str, int] = {}

    def report(stage: str, total: int, more: int) -> None:
        done[stage] = done.get(stage, 0) + more
        progress(stage, done[stage] / max(total, 1), done[stage])

    return report


def facts_of(found: TiledVolume, a: argparse.Namespace) -> dict[str, Any]:
    """What the JSON says: that of ``volume``, and the tiles."""
    index, sums, parameters = found.index, found.sums, found.parameters
    ground = parameters.volume.base == "ground"
    doubts = (*index.doubts, *doubts_of(found, ground))
    return {
        **volume_facts(found.volume, parameters),
        "sigma_holds": held_words(found),
        "footprint": None,
        "lengths": length_facts(parameters),
        "outline_parts": [],
        "surfaces": [],
        "clean": clean_facts(found, a),
        "objects": [dataclasses.asdict(one) for one in found.objects[:MOST_OBJECTS]],
        "tiles": {
            "side_m": index.cloud.tile_m,
            "count": len(sums),
            "points": sum(s.points for s in sums),
            "vertices": sum(s.vertices for s in sums),
            "triangles": sum(s.triangles for s in sums),
            "rounds": max(s.rounds for s in sums),
            "left_out": index.left_out,
            "alone": sum(index.every_point.count.values()) - sum(index.count.values()),
            "folder": str(index.cloud.folder),
            "sigma_from": found.sigma_from,
            "relevant": limits_of(a).relevant,
        },
        "verdict": Verdict(doubts).as_dict(),
        "version": version(),
    }


def clean_facts(found: TiledVolume, a: argparse.Namespace) -> dict[str, Any]:
    """How many points were left out as strays, and what these would change, m³."""
    strays, points = strays_of(found)
    effect = found.stray_effect_m3
    return {"how": a.clean, "strays": strays, "share": strays / points, "effect_m3": effect}


def strays_of(found: TiledVolume) -> tuple[int, int]:
    """How many points were left out as strays, and of how many."""
    every = found.index.cleaned
    strays = every.strays if isinstance(every, CleanedTiles) else 0
    return strays, sum(every.count.values()) + strays


def held_words(found: TiledVolume) -> str:
    """What the standard deviation holds."""
    between = " and what lies between them" * (found.between is not None)
    ground = ", and the ground" * (found.parameters.volume.base == "ground")
    return f"noise of the points{between}{ground} only"


def doubts_of(found: TiledVolume, ground: bool) -> list[Doubt]:
    """What speaks against a volume by tiles."""
    strays, points = strays_of(found)
    out, missing = [*found.doubts, *stray_doubts(strays, points)], list[str]()
    if found.between is None:
        missing += ["gaps", "what lies between the points"]
        missing += ["other readings of the ground"] * ground
    if missing:
        words = (
            f"{', '.join(missing)} of {points:,} points are not judged by tiles, and not in sigma; "
            "hold a part of the cloud against ladar_volume volume"
        )
        out.append(Doubt("tiles_not_judged", words, float(points)))
    if math.isnan(found.volume.sigma_m3):
        out.append(NO_SIGMA)
    return out


def refuse_unknown_options(a: argparse.Namespace) -> None:
    """Raises :class:`ConfigurationError` for options of ``volume`` that tiles do not know."""
    from ladar_volume.cli.main import make_parser

    usual = vars(make_parser(a.verb).parse_args([a.verb, str(a.cloud)]))
    for name, value in vars(a).items():
        if name not in SHARED and value != usual[name]:
            option = "a second cloud" if name == "cloud_b" else f"--{name.replace('_', '-')}"
            words = f"{option} is not done by tiles: leave it out, or use volume without --tile "
            words += "and --dask"
            raise ConfigurationError(words, value=name)

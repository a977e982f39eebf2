"""``ladar_volume tiles``: the volume of a cloud larger than the memory."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable
from typing import Any

from rich.console import Console

from ladar_volume.cli.inputs.reading import reading_of
from ladar_volume.cli.scale.workers import Progress, check_workers, progress_on, workers_of
from ladar_volume.cli.tables.volume_table import show
from ladar_volume.cli.verdict_lines import NO_SIGMA, exit_code
from ladar_volume.cli.volume_facts import volume_facts
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tiles.tile_store import parts_of_file
from ladar_volume.tiles.tile_volume import TileTask, whole_volume
from ladar_volume.tiles.tile_work import TiledSums, sums_of_cloud
from ladar_volume.version import version
from ladar_volume.volume.volume_loads import base_name

#: Mean of the positive part of noise of 1 about 0: no fold is larger, in sigmas of height.
FOLD = 1.0 / math.sqrt(2.0 * math.pi)


def run(arguments: argparse.Namespace) -> int:
    """Deal out, triangulate, add up, print."""
    console, words = Console(stderr=arguments.json), Console(stderr=True)
    task, parameters = task_of(arguments)
    store = arguments.store or arguments.cloud.with_name(arguments.cloud.name + ".tiles")
    with words.status("reading"):
        cloud = parts_of_file(arguments.cloud, store, arguments.tile, reading_of(arguments))
    with workers_of(arguments, words) as workers, progress_on(words) as bars:
        found = sums_of_cloud(cloud, task, workers, shares(bars))
    facts = facts_of(found, task, parameters)
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
        at = facts["tiles"]
        console.print(
            f"{at['points']:,} points, {at['vertices']:,} vertices, {at['triangles']:,} triangles "
            f"in {at['count']:,} tiles of {at['side_m']:g} m, at rest in {at['folder']}"
        )
        for why, count in at["left_out"].items():
            console.print(f"left out: {count:,} {why}")
    return exit_code(arguments, facts["verdict"])


def task_of(a: argparse.Namespace) -> tuple[TileTask, Parameters]:
    """What is asked of each tile, and the parameters it stands for. Raises
    :class:`ConfigurationError`.
    """
    if a.sigma is not None and a.sigma < 0.0:
        raise ConfigurationError(f"--sigma {a.sigma:g}: 0 or more", value=a.sigma)
    check_workers(a)
    relevant = "edge" if a.max_edge is not None else "circumcircle" if a.max_circle else "all"
    base = (a.level,) if a.plane is None else tuple(a.plane)
    start = Parameters()
    volume = dataclasses.replace(start.volume, outline="all")
    if a.plane is None:
        volume = dataclasses.replace(volume, base="level", level_m=a.level)
    else:
        volume = dataclasses.replace(volume, base="plane", plane=base)
    task = TileTask(base, relevant, a.max_edge or math.inf, a.max_circle or math.inf, a.sigma)
    return task, dataclasses.replace(start, volume=volume)


def shares(progress: Progress) -> Callable[[str, int, int], None]:
    """Progress in points of a stage."""
    done: dict[str, int] = {}

    def report(stage: str, total: int, more: int) -> None:
        done[stage] = done.get(stage, 0) + more
        progress(stage, done[stage] / max(total, 1), done[stage])

    return report


def facts_of(found: TiledSums, task: TileTask, parameters: Parameters) -> dict[str, Any]:
    """What the JSON says: that of ``volume``, and the tiles."""
    index, sums = found.index, found.sums
    volume = whole_volume(sums, base_name(parameters))
    points = sum(s.points for s in sums)
    doubts = (*index.doubts, *doubts_of(volume, found, task, points))
    return {
        **volume_facts(volume, parameters),
        "sigma_holds": "noise of the points only",
        "footprint": None,
        "outline_parts": [],
        "surfaces": [],
        "clean": {"how": "off", "strays": 0, "share": 0.0, "effect_m3": None},
        "tiles": {
            "side_m": index.cloud.tile_m,
            "count": len(sums),
            "points": points,
            "vertices": sum(s.vertices for s in sums),
            "triangles": sum(s.triangles for s in sums),
            "rounds": max(s.rounds for s in sums),
            "left_out": index.left_out,
            "folder": str(index.cloud.folder),
            "sigma_from": "given" if task.sigma_m is not None else "local quadrics, tile by tile",
            "relevant": task.relevant,
        },
        "verdict": Verdict(doubts).as_dict(),
        "version": version(),
    }


def doubts_of(volume: CloudVolume, found: TiledSums, task: TileTask, points: int) -> list[Doubt]:
    """What speaks against a volume by tiles."""
    words = (
        f"strays, gaps and what lies between the {points:,} points are not judged by tiles, and "
        "not in sigma; clean the cloud before, limit the triangles with --max-edge, and hold a "
        "part of it against ladar_volume volume"
    )
    out = [Doubt("tiles_not_judged", words, float(points))]
    if math.isnan(volume.sigma_m3):
        return [*out, NO_SIGMA]
    sigma = max((s.sigma_m for s in found.sums if s.sigma_m is not None), default=0.0)
    fold = FOLD * sigma * volume.near_area_m2
    if fold > volume.sigma_m3:
        words = (
            f"{volume.near_area_m2:.4g} m² lie within the noise of the base: cut and fill may each "
            f"be {fold:.3g} m³ too large there, the net volume is not; take another level"
        )
        out.append(Doubt("near_base", words, fold))
    return out

"""``ladar_volume volume``: cut and fill of a point cloud file above a base, or between two of
them.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console

from ladar_volume.cli.inputs.base_choice import parameters_of
from ladar_volume.cli.inputs.mesh_source import mesh_doubts, noise_doubts
from ladar_volume.cli.inputs.reading import Source, clouds_of, reading_doubts
from ladar_volume.cli.outputs.cloud_files_out import (
    system_of_files,
    wanted_files,
    write_files,
)
from ladar_volume.cli.outputs.file_choice import show_written
from ladar_volume.cli.scale.workers import check_workers
from ladar_volume.cli.site.pile_results import (
    common_material,
    error_facts,
    height_errors,
    outline_facts,
    outlines_of,
    pile_facts,
    pile_volumes,
    sigma_words,
)
from ladar_volume.cli.site.trajectory import check_trajectory, flown_of
from ladar_volume.cli.surface_options import (
    frame_facts,
    frame_of,
    make_surface,
    option_facts,
    read_surface,
    surface_facts,
    surface_options,
    with_sigmas_alone,
    without_places,
)
from ladar_volume.cli.tables.volume_table import show
from ladar_volume.cli.verdict_lines import exit_code
from ladar_volume.cli.volume_facts import level_facts, pair_facts, volume_facts
from ladar_volume.clouds.cloud_levels import (
    above_floor,
    level_list,
    sequence,
)
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import (
    CloudVolume,
    above_base,
    between_clouds,
    difference_of_footprints,
)
from ladar_volume.clouds.ground_readings import ground_readings
from ladar_volume.clouds.pair_verdict import pair_ground, pair_verdict
from ladar_volume.clouds.sampling.cloud_objects import nearly_all_above, without_objects
from ladar_volume.clouds.sampling.height_axis import check_height_axis
from ladar_volume.clouds.sampling.pair_objects import without_new_objects
from ladar_volume.clouds.sampling.site_lengths import (
    length_facts,
    named_lengths,
    site_lengths,
    size_of,
)
from ladar_volume.clouds.sampling.stray_effect import stray_effect
from ladar_volume.clouds.volume_verdict import (
    apart_doubts,
    counted_areas,
    places,
    seen_volume,
    stray_doubts,
    surface_doubts,
    volume_with_verdict,
    with_gaps,
)
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.io.results import MOST_OBJECTS, json_text
from ladar_volume.io.site.outline_files import Outlines
from ladar_volume.math.run_concurrently import run_concurrently
from ladar_volume.model.errors import ConfigurationError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import HeightError
from ladar_volume.model.records import F64, Bool, Plane, StandingObject, Tin
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Verdict
from ladar_volume.piles.pile_site import SiteTask
from ladar_volume.piles.pile_volumes import SitePiles
from ladar_volume.process.memory import return_free
from ladar_volume.tin.scan_frame import Frame
from ladar_volume.version import version
from ladar_volume.volume.base import polygon_of
from ladar_volume.volume.polygon import check_polygon
from ladar_volume.volume.published_methods import front_level, zero_fill_level

#: Levels over the height of both surfaces, among which that in front of a body is searched.
SEARCHED_LEVELS = 2000


@dataclass(frozen=True)
class VolumeTask:
    """What is asked for.

    arguments : the command line · parameters : of base, outline and ground · base : as
    :func:`parameters_of` names it · options : of the surfaces · levels : (l,), m, or None · frame :
    in which the surfaces are, or None for the map's own · correct : whether cut and fill are
    corrected near the base · shared_errors : errors that heights share · flight : parameters of the
    trajectory, None without one · outlines : of piles, None to find them · progress : takes what is
    being done, in words · points_let_go : whether nothing needs the points of the files once the
    surfaces are made: they take memory
    """

    arguments: argparse.Namespace
    parameters: Parameters
    base: str
    options: SurfaceParameters
    levels: F64 | None
    frame: Frame | None
    correct: bool
    shared_errors: tuple[HeightError, ...] = ()
    flight: Parameters | None = None
    outlines: Outlines | None = None
    progress: Callable[[str], None] = lambda words: None
    points_let_go: bool = False


@dataclass(frozen=True)
class CutFill:
    """A volume and what it counts.

    volume : cut, fill and net · parameters : with the level or plane that was found · level_base :
    the base from which levels count, or None · counted : for each surface the triangles (m,) that
    count · each : the volumes of two surfaces with a base of their own · site : the piles, where
    these were asked for
    """

    volume: CloudVolume
    parameters: Parameters
    level_base: Plane | None
    counted: list[Bool]
    each: list[CloudVolume]
    site: SitePiles | None = None


@dataclass(frozen=True)
class JudgedVolume:
    """A volume after its verdict, the verdict, and as plain values the readings of the ground,
    where there are any.
    """

    volume: CloudVolume
    verdict: Verdict
    facts: dict[str, Any]


def run(arguments: argparse.Namespace) -> int:
    """Read, triangulate, compute, print."""
    if (arguments.tile, arguments.dask) != (None, None):
        from ladar_volume.cli.scale.tiles import run as run_tiles

        return run_tiles(arguments)
    check_workers(arguments)
    console = Console(stderr=arguments.json)
    with console.status("reading") as status:
        wanted = wanted_files(arguments)
        task = dataclasses.replace(task_of(arguments), points_let_go=wanted is None)
        sources = read_sources(arguments)
        system_of_files(arguments, sources)  # refuses units that files cannot have
        result = result_of(task, sources, status.update)
        facts, written = result.facts, None
        if wanted is not None:
            status.update("files")
            written = write_files(arguments, wanted, sources, result)
        if arguments.report is not None:
            status.update("report")
            report_of(arguments, result)
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
        if written is not None:
            show_written(console, arguments.output, written)
    return exit_code(arguments, facts["verdict"])


def report_of(arguments: argparse.Namespace, result: VolumeResult) -> None:
    """Write the report and its JSON twin."""
    from ladar_volume.report.cloud_report import CloudReport, write_cloud_report  # matplotlib

    files = [p for p in (arguments.cloud, arguments.cloud_b) if p is not None]
    piles = list(zip(result.outlines, result.planes, strict=False))
    r = result
    report = CloudReport(files, r.surfaces, r.base, r.counted, r.facts, piles)
    write_cloud_report(report, arguments.report)


def task_of(arguments: argparse.Namespace) -> VolumeTask:
    """What the options ask for; the frame is known with the points. Raises
    :class:`ConfigurationError` for options that contradict one another.
    """
    parameters, base = parameters_of(arguments)
    options = surface_options(arguments, SurfaceParameters(ratio=1.0))
    levels = None if arguments.levels is None else level_list(*arguments.levels)
    correct = not arguments.no_correction
    shared = height_errors(arguments)
    common_material(arguments)
    flight = check_trajectory(arguments)
    if parameters.volume.names_plants:
        check_cover(arguments)
    return VolumeTask(arguments, parameters, base, options, levels, None, correct, shared, flight)


def check_cover(arguments: argparse.Namespace) -> None:
    """Refuse plants of a known height where no body above one base is measured."""
    a = arguments
    wrong = {
        "a second cloud": a.cloud_b is not None,
        "--levels": a.levels is not None,
        "--frame scan": a.frame == "scan",
    }
    for name, is_wrong in wrong.items():
        if is_wrong:
            raise ConfigurationError(
                "volume.ground_cover_m and body_cover_m are of one surface above one base: leave "
                f"out {name}",
                value=name,
            )


@dataclass(frozen=True)
class VolumeResult:
    """surfaces : of the files · base : of the first, None where the second is the base · counted :
    triangles (m,) of the first that count · facts : what the JSON says · outlines : polygons (k, 2)
    that cut these off, none where they count whole · planes : near the base within each outline
    """

    surfaces: list[CloudSurface]
    base: Plane | None
    counted: Bool
    facts: dict[str, Any]
    outlines: tuple[F64, ...] = ()
    planes: tuple[Plane | None, ...] = ()


def result_of(
    task: VolumeTask, sources: list[Source], progress: Callable[[str], None]
) -> VolumeResult:
    """The volume of one or two sources, with its verdict. Their points are let go of where the task
    says so.
    """
    doubts = reading_doubts(clouds_of(sources))
    if task.arguments.frame == "scan":
        progress("turning into the scan frame")
    frame = frame_of(task.arguments, sources)
    check_axes([] if frame is not None else sources)
    outlines = outlines_of(task.arguments, sources)
    task = dataclasses.replace(task, frame=frame, outlines=outlines, progress=progress)
    flown = flown_of(task.arguments, sources, task.flight)
    doubts += flown.doubts
    surfaces = flown.onto(make_surfaces(task, sources, progress))
    if task.points_let_go:
        sources[:] = [without_places(source) for source in sources]
    progress("cut and fill")
    facts, found = compute_volume(task, surfaces)
    clean = stray_facts(task, sources, surfaces, found)
    paths = [s.path for s in sources]
    doubts += mesh_doubts(paths, [s.mesh for s in sources], surfaces)
    doubts += noise_doubts(paths, surfaces)
    doubts += tuple(stray_doubts(clean["strays"], point_count(sources, surfaces)))
    if task.outlines is not None:
        facts["outlines"] = outline_facts(task.arguments, task.outlines)
        doubts += task.outlines.doubts
    facts["verdict"] = (Verdict(doubts) + facts.pop("verdict")).as_dict()
    facts |= {
        "sigma_holds": sigma_words(task.shared_errors, task.flight is not None),
        "shared_errors": error_facts(task.shared_errors),
        "trajectory": flown.facts,
    }
    facts["clean"] = clean
    facts |= facts_of_surfaces(task, sources, surfaces)
    base, counted = base_of(task, found), found.counted[0]
    planes = () if found.site is None else tuple(pile.reference for pile in found.site.piles)
    return VolumeResult(surfaces, base, counted, facts, polygons_that_count(found), planes)


def facts_of_surfaces(
    task: VolumeTask, sources: list[Source], surfaces: list[CloudSurface]
) -> dict[str, Any]:
    """What the JSON says of the surfaces, however their volume is."""
    return {
        "objects": [dataclasses.asdict(one) for one in standing_on(surfaces)],
        "surfaces": [surface_facts(a, b) for a, b in zip(sources, surfaces, strict=True)],
        "frame": frame_facts(task.frame),
        "options": option_facts(task.options),
        "version": version(),
    }


def standing_on(surfaces: list[CloudSurface]) -> list[StandingObject]:
    """What was taken out of the surfaces, the largest first."""
    out = sorted((one for s in surfaces for one in s.objects), key=lambda one: -one.volume_m3)
    return out[:MOST_OBJECTS]


def check_axes(sources: list[Source]) -> None:
    """Refuse clouds whose heights are in another column than z."""
    for source in sources:
        if source.mesh is None:
            check_height_axis(source.cloud.r)


def polygons_that_count(found: CutFill) -> tuple[F64, ...]:
    """The polygons (k, 2) that cut off what counts."""
    if found.site is not None:
        return tuple(check_polygon(pile.pile.ring) for pile in found.site.piles)
    v = found.parameters.volume
    return (polygon_of(v),) if v.outline == "polygon" else ()


def base_of(task: VolumeTask, found: CutFill) -> Plane | None:
    """The base of the first surface; None where the second is it."""
    if found.site is not None and len(found.site.piles) == 1:
        return found.site.piles[0].plane
    if task.base in ("cloud", "second") or found.level_base is not None:
        return found.level_base
    if found.site is not None and task.base not in ("level", "plane"):
        return None  # every pile has one of its own
    return design_surface([found.parameters.volume.level_m])


def read_sources(arguments: argparse.Namespace) -> list[Source]:
    """The one or two files; their columns where they go into files or a trajectory needs them."""
    read = [
        read_surface(path, arguments, second)
        for path, second in ((arguments.cloud, False), (arguments.cloud_b, True))
        if path is not None
    ]
    if wanted_files(arguments) is None and arguments.trajectory is None:
        return [with_sigmas_alone(source) for source in read]
    return read


def make_surfaces(
    task: VolumeTask, sources: list[Source], progress: Callable[[str], None]
) -> list[CloudSurface]:
    """The surface of each file."""
    a = task.arguments
    sigmas = (a.sigma, a.sigma if a.sigma_b is None else a.sigma_b)
    surfaces = []
    for source, sigma in zip(sources, sigmas, strict=False):
        progress(f"triangulating {len(source.cloud.r):,} points of {source.path.name}")
        made = make_surface(a, source, task.options, task.frame, sigma)
        surfaces.append(cleared_surface(task, made) if len(sources) == 1 else made)
    if len(surfaces) == 2:
        surfaces = cleared_pair(task, surfaces)
    return [dataclasses.replace(made, shared_errors=task.shared_errors) for made in surfaces]


def cleared_pair(task: VolumeTask, surfaces: list[CloudSurface]) -> list[CloudSurface]:
    """Two surfaces without what stands on one of them alone, where they are compared."""
    kept = task.arguments.clean == "off" or task.parameters.volume.objects != "remove"
    if kept or task.frame is not None or task.base not in ("cloud", "second"):
        return surfaces
    task.progress("what stands on one of the two")
    fitted = with_site_lengths(task, surfaces[0]).parameters
    return without_new_objects(surfaces, fitted, task.options)


def cleared_surface(task: VolumeTask, surface: CloudSurface) -> CloudSurface:
    """The surface without what stands on it, above its ground, a level or a given plane, or in
    outlines that are given. Where no body is looked for, what is nearly all that rises above the
    base is what is measured, and stays.
    """
    v, a = task.parameters.volume, task.arguments
    if a.clean == "off" or v.objects != "remove":
        return surface
    rings: list[F64] = []
    if task.outlines is not None:
        rings = [check_polygon(pile.ring) for pile in task.outlines.piles]
    elif a.piles is None:
        if task.frame is not None or task.base not in ("ground", "level", "plane"):
            return surface
        rings = [polygon_of(v)] if v.outline == "polygon" else []
    task.progress("what stands on the surface")
    fitted = with_site_lengths(task, surface).parameters
    if a.piles is not None:  # piles that are found stand on the ground, whatever their base
        volume = dataclasses.replace(fitted.volume, base="ground", outline="auto")
        fitted = dataclasses.replace(fitted, volume=volume)
    cleared = without_objects(surface, fitted, task.options, rings)
    by_body = fitted.volume.base == "ground" and fitted.volume.outline == "auto"
    if not cleared.objects or by_body or task.outlines is not None:
        return cleared
    return surface if nearly_all_above(cleared, fitted) else cleared


def point_count(sources: list[Source], surfaces: list[CloudSurface]) -> int:
    """Points of all files; those with the same coordinates count once."""
    return sum(len(s.cloud.r) for s in sources) - sum(s.copies for s in surfaces)


def compute_volume(
    task: VolumeTask, surfaces: list[CloudSurface]
) -> tuple[dict[str, Any], CutFill]:
    """The volume with its verdict, where levels are asked for the sequence with its floors; and
    what it counts.
    """
    return_free()
    task = with_site_lengths(task, surfaces[0])
    found = named_base(task, cut_and_fill(in_frame(task, surfaces), surfaces))
    return_free()
    # piles count on the first surface alone
    areas = [counted_areas(s, m) for s, m in zip(surfaces, found.counted, strict=False)]
    judgement = volume_verdict(task, surfaces, found, areas)
    more: dict[str, Any] = {}
    if found.each:
        more["each"] = [volume_facts(v, found.parameters) for v in found.each]
    more |= judgement.facts
    more["outline_parts"] = [dataclasses.asdict(p) for p in places(surfaces[0], areas[0])]
    if task.levels is not None:
        level_base = None if task.base == "level" else found.level_base
        more |= level_facts(surfaces, task.levels, level_base, task.correct)
    if task.arguments.method is not None:
        at = levels_of_pairs(task, found.parameters.volume.level_m)
        more["pairs"] = pair_facts(surfaces, task.arguments.method, at, offset_of(task))
    facts = volume_facts(judgement.volume, found.parameters)
    facts |= {
        "footprint": task.arguments.footprint if len(surfaces) == 2 else None,
        "lengths": length_facts(found.parameters),
        **more,
    }
    return {**facts, "verdict": judgement.verdict}, found


def with_site_lengths(task: VolumeTask, surface: CloudSurface) -> VolumeTask:
    """The task with lengths that go with the site, but for those that ``--set`` names."""
    fitted = site_lengths(task.parameters, size_of(surface), named_lengths(task.arguments.set))
    return dataclasses.replace(task, parameters=fitted)


def in_frame(task: VolumeTask, surfaces: list[CloudSurface]) -> VolumeTask:
    """The task with a given plane in the frame of the surfaces, and the lowest level."""
    volume = task.parameters.volume
    if task.base == "plane" and task.frame is not None:
        turned = tuple(task.frame.plane(np.array(task.arguments.plane)).tolist())
        volume = dataclasses.replace(volume, plane=turned)
    elif task.base in ("lowest", "front"):
        tins, offset = (
            (surfaces[0].representation.tin, surfaces[1].representation.tin),
            offset_of(task),
        )
        level = zero_fill_level(*tins, offset)
        if task.base == "front":
            level = front_level(*tins, (highest(tins) - level) / SEARCHED_LEVELS, offset)
        volume = dataclasses.replace(volume, level_m=level)
    else:
        return task
    return dataclasses.replace(task, parameters=dataclasses.replace(task.parameters, volume=volume))


def highest(tins: tuple[Tin, Tin]) -> float:
    """The greatest height of two surfaces, m."""
    return max(float(t.vertices[t.triangles[t.relevant], 2].max()) for t in tins)


def levels_of_pairs(task: VolumeTask, found_m: float) -> F64:
    """Levels (m,) m of the first surface at which the volumes are compared: as given, or the one
    that was found. Refused where the fill does not hold the whole body.
    """
    levels = np.array([found_m]) if task.levels is None else task.levels
    if task.arguments.method == 1 and levels.min() < found_m:
        raise VolumeError(
            f"the level {levels.min():.6g} m cuts the body, which ends below {found_m:.6g} m: "
            "Method 1 needs levels in front of it",
            reason="volume_levels",
            value=float(levels.min()),
        )
    return levels


def offset_of(task: VolumeTask) -> float:
    """By how much the first surface lies above the second, m."""
    return float(task.arguments.offset or 0.0)


def cut_and_fill(task: VolumeTask, surfaces: list[CloudSurface]) -> CutFill:
    """The volume above the base, between two surfaces, or of each over its own footprint."""
    first, parameters, correct = surfaces[0], task.parameters, task.correct
    if task.arguments.piles is not None:
        asked = SiteTask(parameters, task.base, correct=correct)
        site = pile_volumes(task.arguments, asked, task.outlines, surfaces, task.progress)
        return CutFill(site.total, parameters, None, [site.inside_m2 > 0], [], site)
    relevant = [s.representation.tin.relevant for s in surfaces]
    if task.base == "cloud":
        volume = between_clouds(first, surfaces[1], "the second", correct)
        return CutFill(volume, parameters, None, relevant, [])
    if len(surfaces) == 2:
        volume, one, two = difference_of_footprints(
            first, surfaces[1], parameters, correct, offset_of(task)
        )
        return CutFill(volume, parameters, None, relevant, [one, two])
    if task.base == "floor" and task.levels is not None:
        levels = sequence(first, task.levels)
        volume, parameters = above_floor(first, levels, parameters, correct)
        return CutFill(volume, parameters, None, relevant, [])
    volume, base, counted = above_base(first, parameters, correct)
    return CutFill(volume, parameters, base, [counted], [])


def named_base(task: VolumeTask, found: CutFill) -> CutFill:
    """The volume with its base in the user's words: the second file, or the plane as given."""
    if task.base == "cloud":
        words = f"surface of {second_name(task.arguments)} over the common footprint"
    elif task.base == "plane" and task.frame is not None:
        words = "given plane z = {:.6g} + {:.6g} x + {:.6g} y".format(*task.arguments.plane)
    else:
        return found
    return dataclasses.replace(found, volume=dataclasses.replace(found.volume, base=words))


def volume_verdict(
    task: VolumeTask, surfaces: list[CloudSurface], found: CutFill, areas: list[F64]
) -> JudgedVolume:
    """What speaks against the volume. A mesh has no sampling to judge."""
    if found.site is not None:
        verdict, facts = pile_facts(found.site, task.arguments, found.parameters)
        return JudgedVolume(found.volume, verdict, facts)
    if len(surfaces) == 1 and surfaces[0].given_faces is None:
        surface, area, p, base = surfaces[0], areas[0], found.parameters, found.level_base
        if task.base == "floor":
            base = design_surface([p.volume.level_m])
        ground = base if task.base == "ground" else None
        gapped = with_gaps(found.volume, surface, area, base, p.volume.outline)
        return_free()
        seen, readings = run_concurrently(
            lambda: seen_volume(gapped, surface, area, base),
            lambda: None if ground is None else ground_readings(surface, ground, area, p),
        )
        volume, verdict = volume_with_verdict(seen, surface, area, readings, p, base)
        facts = {"readings": None if readings is None else dataclasses.asdict(readings)}
        return JudgedVolume(volume, verdict, facts)
    verdict = Verdict()
    for surface, area in zip(surfaces, areas, strict=True):
        if surface.given_faces is None:
            verdict += Verdict(tuple(surface_doubts(surface, area)))
    volume = found.volume
    if task.base == "cloud" and all(s.given_faces is None for s in surfaces):
        volume, more = pair_verdict(volume, surfaces, areas, pair_ground(surfaces))
        verdict += more
    if task.base == "cloud":
        verdict += Verdict(tuple(apart_doubts(volume)))
    return JudgedVolume(volume, verdict, {})


def stray_facts(
    task: VolumeTask, sources: list[Source], surfaces: list[CloudSurface], found: CutFill
) -> dict[str, Any]:
    """How many points were left out as strays, and what that changes above the same base and within
    the same outline, m³; None where there are none.
    """
    strays = sum(len(s.strays) for s in surfaces)
    effect = 0.0
    for sign, surface, mask in zip((1.0, -1.0), surfaces, found.counted, strict=False):
        if len(surface.strays):
            tin, area = surface.representation.tin, counted_areas(surface, mask)
            effect += sign * stray_effect(tin, area, surface.stray_points, found.level_base)
    return {
        "how": task.arguments.clean,
        "strays": strays,
        "share": strays / max(point_count(sources, surfaces), 1),
        "effect_m3": effect if strays else None,
    }


def second_name(a: argparse.Namespace) -> str:
    """What the second surface is called."""
    name = str(a.cloud_b.name)
    return name if a.surface_b is None else f"{a.surface_b} in {name}"

"""``ladar_volume body``: the volumes of closed bodies from a point cloud or a mesh file."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.cli.body_facts import cloud_facts, mesh_facts, show
from ladar_volume.cli.inputs.reading import (
    Source,
    add_reading_rows,
    cloud_facts_of,
    mesh_in_metres,
    read_source,
    reading_doubts,
)
from ladar_volume.cli.verdict_lines import NO_SIGMA, exit_code
from ladar_volume.clouds.body_checks import (
    check_bodies,
    check_doubts,
    uncertainty,
)
from ladar_volume.clouds.body_points import (
    BodyPoints,
    excluded_points,
    filtered_points,
    good_points,
    ground_threshold,
    noise_shapes_mesh,
    step_between,
    unfiltered_points,
    with_noise,
)
from ladar_volume.clouds.body_verdict import (
    TOO_MANY,
    MissedPoints,
    bodies_verdict,
    check_missed,
    filter_doubts,
    missed_points,
)
from ladar_volume.clouds.body_volume import Body, body_of, mesh_uncertainty
from ladar_volume.clouds.body_walls import closing_doubts, foot_doubts, wall_doubts
from ladar_volume.clouds.cloud_bodies import CLEAR, cloud_bodies
from ladar_volume.clouds.filter.filter_result import CloudResult
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.clouds.ground_cover import doubts_about_growth, growth_about_bodies
from ladar_volume.clouds.ground_readings import with_base_surface
from ladar_volume.ground.ground_presets import PRESETS
from ladar_volume.ground.objects import (
    Objects,
    find_objects,
    heights_above_ground,
    objects_at_places,
    objects_in_regions,
)
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.ground.regions import in_box, in_polygon
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.io.endings import ENDINGS
from ladar_volume.io.meshfiles.body_mesh import write_bodies
from ladar_volume.io.meshfiles.mesh_files import holds_faces, read_mesh
from ladar_volume.io.results import json_text
from ladar_volume.model.body_parameters import BodyParameters, LocalMeshParameters, ObjectParameters
from ladar_volume.model.errors import (
    ConfigurationError,
    GroundError,
    InputError,
    OutputError,
    SurfaceError,
)
from ladar_volume.model.parameters import FilterParameters, GroundParameters
from ladar_volume.model.records import F64, Plane
from ladar_volume.model.verdict import Doubt, Verdict

#: An object is picked from so many longest steps between its points.
PICKED = 3.0


def run(arguments: argparse.Namespace) -> int:
    """Read, make bodies, write, print."""
    check(arguments)
    console = Console(stderr=arguments.json)
    facts, bodies = (bodies_of_mesh if holds_faces(arguments.source) else bodies_of_cloud)(
        arguments, console
    )
    write_bodies(arguments.output, bodies)
    facts["output"] = {
        "path": arguments.output.name,
        "faces": sum(len(b.skin.triangles) for b in bodies),
    }
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(console, facts)
        show_reading(console, facts)
    return exit_code(arguments, facts["verdict"])


def show_reading(console: Console, facts: dict[str, Any]) -> None:
    """Print how the cloud was read."""
    table = Table(show_header=False, box=None, pad_edge=False)
    if "reading" in facts:
        add_reading_rows(table, facts["reading"])
        console.print(table)


def check(arguments: argparse.Namespace) -> None:
    """Refuse options that contradict each other, before anything is read."""
    a = arguments
    if a.output.suffix.lower() not in ENDINGS:
        raise OutputError(
            f"{a.output}: no known kind of mesh file ({', '.join(ENDINGS)})",
            reason="output_format",
            value=str(a.output),
        )
    if a.output.resolve() == a.source.resolve():
        raise OutputError("the input and the output must be different files", value=str(a.output))
    if len([kind for kind in (a.polygon, a.box, a.pick) if kind]) > 1:
        raise ConfigurationError(
            "bodies come from --polygon, from --box or from --pick: choose one"
        )
    for name in ("min_height", "min_points", "distance", "radius", "close", "sigma", "split"):
        value = getattr(a, name)
        if value is not None and not (np.isfinite(value) and value >= 0.0):
            raise ConfigurationError(
                f"--{name.replace('_', '-')} {value}: a number from 0 up", value=value
            )
    if not (0.0 <= a.sharp < 180.0):
        raise ConfigurationError(f"--sharp {a.sharp}: degrees from 0 to 180", value=a.sharp)
    if a.no_filter and a.radius is not None:
        raise ConfigurationError("--radius is the filter's, which --no-filter leaves out")
    if a.ground_preset is not None and a.ground not in (None, "auto"):
        raise ConfigurationError("--ground-preset is for a ground found in the cloud")
    if a.repair is not None and not a.mesh_radius > 0.0:
        raise ConfigurationError("--repair needs --mesh-radius, the radius of Algorithm 2 in m")
    if a.repair is not None and a.ground not in (None, "none"):
        raise ConfigurationError(
            "--repair is for bodies seen from all sides: --ground none, or leave --repair out"
        )
    if holds_faces(a.source) and (
        a.ground == "auto" or a.polygon or a.box or a.pick or a.no_filter or a.radius or a.repair
    ):
        raise ConfigurationError(
            f"{a.source} is a mesh: --ground Z or Z,SX,SY, --close, --sigma, --pole and "
            "--allow-crossings apply to it"
        )


def sharp_rad(arguments: argparse.Namespace) -> float | None:
    """The angle from which on edges are completed."""
    return float(np.radians(arguments.sharp)) if arguments.sharp > 0.0 else None


def pole(arguments: argparse.Namespace) -> F64 | None:
    """The pole asked for."""
    return None if arguments.pole is None else np.array(arguments.pole)


def given_ground(arguments: argparse.Namespace) -> Plane | None:
    """A level or plane from the command line, known without error."""
    return design_surface(list(arguments.ground)) if isinstance(arguments.ground, tuple) else None


def bodies_of_mesh(
    arguments: argparse.Namespace, console: Console
) -> tuple[dict[str, Any], list[Body]]:
    """The body in a mesh file."""
    a = arguments
    with console.status(f"reading {a.source.name}") as status:
        mesh = mesh_in_metres(read_mesh(a.source, a.surface), a)
        status.update("closing and adding up")
        try:
            body = body_of(
                mesh.vertices,
                mesh.triangles,
                None,
                None,
                a.close,
                given_ground(a),
                sharp_rad(a),
                pole(a),
                a.allow_crossings,
            )
        except SurfaceError as error:
            raise SurfaceError(
                f"{a.source}: {error}", reason=error.reason, value=error.value
            ) from error
        uncertain = None if a.sigma is None else mesh_uncertainty([body], a.sigma)
    return mesh_facts(a.source.name, mesh, body, uncertain), [body]


def bodies_of_cloud(a: argparse.Namespace, console: Console) -> tuple[dict[str, Any], list[Body]]:
    """The bodies of a point cloud file."""
    with console.status(f"reading {a.source.name}") as status:
        source = read_source(a.source, a)
        raw = source.cloud.r
        if not a.no_filter:
            status.update(f"filtering {len(raw):,} points")
        points = (
            given_points(source, a.sigma) if a.no_filter else filtered_points(filter_points(a, raw))
        )
        status.update("looking for the ground and what stands on it")
        points, ground, doubts = body_points_and_ground(a, raw, points)
        found, missed = (None, None) if ground is None else objects_of(a, points, ground)
        label = np.zeros(len(points.r), np.int64) if found is None else found.label
        options = BodyParameters(mesh_settings(a), a.close, sharp_rad(a) or 0.0, pole(a))
        made = cloud_bodies(
            points.r,
            points.normal,
            points.curved,
            label,
            ground,
            options,
            lambda k, many: status.update(f"meshing and closing body {k + 1} of {many}"),
        )
        status.update("propagating the noise")
        made, checked = check_bodies(made, points, raw, options)
        growth_m = growth_about_bodies(raw, made, points)
        known = uncertainty(made, checked, points, raw, growth_m)
        uncertain = known and with_base_surface(known, made, points, raw)
    facts = cloud_facts(a.source.name, len(raw), points, made, found, uncertain)
    facts["reading"] = cloud_facts_of(source.cloud)
    facts["above_ground"] = None if missed is None else dataclasses.asdict(missed)
    verdict = Verdict(reading_doubts([source.cloud])) + bodies_verdict(made, points.r, missed)
    verdict += Verdict(doubts + check_doubts(checked) + foot_doubts(made, points))
    grown = doubts_about_growth(made, growth_m)
    verdict += Verdict(wall_doubts(made, points) + closing_doubts(made) + grown)
    verdict += Verdict(tuple(d for body in made.bodies for d in body.doubts))
    verdict += Verdict((NO_SIGMA,) if uncertain is None else ())
    facts["verdict"] = verdict.as_dict()
    return facts, list(made.bodies)


def filter_points(arguments: argparse.Namespace, raw: F64) -> CloudResult:
    """The filter's answer to a cloud (n, 3) m."""
    p = FilterParameters(seed=arguments.seed)
    if arguments.radius is not None:
        p = dataclasses.replace(p, radius_m=arguments.radius)
    return filter_cloud(raw, p, auto=arguments.radius is None)


def body_points_and_ground(
    arguments: argparse.Namespace, raw: F64, points: BodyPoints
) -> tuple[BodyPoints, Plane | None, tuple[Doubt, ...]]:
    """The points that bodies are made of, their ground, and what speaks against them: a filter's,
    or the cloud (n, 3) m as it came where the filter left out too much of what rises.
    """
    ground = ground_of(arguments, points)
    result = points.filtered
    if result is None:
        return points, ground, ()
    good = good_points(raw, result)
    lost = excluded_points(raw, good, result, ground)
    if lost.share <= TOO_MANY:
        return points, ground, ()
    if ground is not None and len(ground.support):
        came = unfiltered_points(raw, good, points.noise_m, lost.share)
        came = with_noise(came, ground_of_cloud(arguments, came).rms_m)
        if not noise_shapes_mesh(lost, came.noise_m):
            return came, ground_of(arguments, came), ()
    return points, ground, filter_doubts(lost)


def given_points(source: Source, sigma: float | None) -> BodyPoints:
    """Points of a file that are on the surface already, with their normals and sigmas where there
    are any.
    """
    r, columns = source.cloud.r, source.cloud.columns
    normals = np.asarray(columns["normal"], dtype=np.float64) if "normal" in columns else None
    if sigma is not None or "sigma" not in columns:
        return BodyPoints(r, normals, None, None if sigma is None else np.full(len(r), sigma))
    values = np.asarray(columns["sigma"], dtype=np.float64)
    if values.shape != (len(r),) or not (np.isfinite(values) & (values >= 0.0)).all():
        raise InputError(
            f"{source.path}: the column 'sigma' holds no standard deviations; give --sigma",
            reason="input_sigma",
        )
    return BodyPoints(r, normals, None, values)


def ground_of(arguments: argparse.Namespace, points: BodyPoints) -> Plane | None:
    """The ground asked for; found by default."""
    if arguments.ground == "none" or (arguments.repair is not None and arguments.ground is None):
        return None
    given = given_ground(arguments)
    return given if given is not None else ground_of_cloud(arguments, points)


def ground_of_cloud(arguments: argparse.Namespace, points: BodyPoints) -> Plane:
    """The ground that points show."""
    sigma = np.zeros(len(points.r)) if points.sigma is None else points.sigma
    chosen = {} if arguments.ground_preset is None else PRESETS[arguments.ground_preset]
    p = GroundParameters(**{"degree": 1, **chosen, "seed": arguments.seed})
    try:
        return fit_ground(points.r, sigma**2, p, ground_threshold(points))
    except GroundError as error:
        ways = "--ground Z gives a level, --ground none means a body that is seen from all sides"
        raise GroundError(
            f"{arguments.source}: {error}; {ways}", reason=error.reason, value=error.value
        ) from error


def objects_of(
    arguments: argparse.Namespace, points: BodyPoints, ground: Plane
) -> tuple[Objects, MissedPoints | None]:
    """The objects asked for; all that are found by default, and what is in none of them."""
    a, r = arguments, points.r
    p = object_parameters(a, points, ground)
    if a.pick:
        return objects_at_places(r, [ground], [np.array(at)[None] for at in a.pick], p), None
    regions = [in_polygon(r, np.array(ring)) for ring in a.polygon]
    regions += [in_box(r, np.array(box[:3]), np.array(box[3:])) for box in a.box]
    if regions:
        return objects_in_regions(r, [ground], regions, p), None
    found = find_objects(r, [ground], p)
    missed = missed_points(r, ground, found, p)
    check_missed(missed)
    return found, missed


def object_parameters(
    arguments: argparse.Namespace, points: BodyPoints, ground: Plane
) -> ObjectParameters:
    """What an object is, in the cloud's own measure where nothing is asked for."""
    a = arguments
    noise = points.noise_m or ground.rms_m
    p = ObjectParameters(min_height_m=CLEAR * noise if a.min_height is None else a.min_height)
    given = {"min_points": a.min_points, "distance_m": a.distance, "split_m": a.split}
    p = dataclasses.replace(p, **{key: value for key, value in given.items() if value is not None})
    if a.distance is not None:
        return p
    step_m = step_between(points.r[heights_above_ground(points.r, [ground], p)[1]])
    if not step_m:
        return p
    return dataclasses.replace(p, distance_m=step_m, step_m=step_m, pick_reach_m=PICKED * step_m)


def mesh_settings(arguments: argparse.Namespace) -> LocalMeshParameters:
    """Settings of the local meshes."""
    if arguments.repair is None:
        return LocalMeshParameters(arguments.mesh_radius)
    return LocalMeshParameters(arguments.mesh_radius, method="published", repair=arguments.repair)

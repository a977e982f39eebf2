"""The change between two point clouds or meshes, with the noise of their points and what they
differ by where nothing changed.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from pathlib import Path
from statistics import NormalDist
from typing import Any

from rich.console import Console

from ladar_volume.cli.epochs.outputs import plan_of, write_comparison
from ladar_volume.cli.inputs.mesh_source import mesh_doubts
from ladar_volume.cli.inputs.reading import Source, clouds_of, reading_doubts
from ladar_volume.cli.surface_options import (
    make_surface,
    read_surface,
    surface_facts,
    surface_options,
)
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.epochs.cloud_change import CloudChange, cloud_change
from ladar_volume.clouds.epochs.cloud_registration import Registration, by_height, by_icp
from ladar_volume.clouds.pair_verdict import named_part, pair_ground
from ladar_volume.clouds.sampling.pair_objects import without_new_objects
from ladar_volume.clouds.sampling.site_lengths import site_lengths, size_of
from ladar_volume.io.results import MOST_OBJECTS
from ladar_volume.io.transforms import read_transform, read_transform_verdict
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import F64
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.model.verdict import Verdict
from ladar_volume.registration.transform import Transform
from ladar_volume.version import version


def compare_clouds(arguments: argparse.Namespace, folder: Path, console: Console) -> dict[str, Any]:
    """Read, compare and write; returns what was found."""
    polygon, stable = plan_of(arguments.polygon), plan_of(arguments.stable)
    with console.status("reading") as status:
        sources = [read_surface(path, arguments) for path in (arguments.previous, arguments.new)]
        doubts = Verdict(reading_doubts(clouds_of(sources)))
        status.update("triangulating")
        registration, surfaces = registered(arguments, sources, stable)
        status.update("what stands on one of the two")
        surfaces = cleared(arguments, surfaces)
        previous, new = surfaces
        status.update("comparing")
        k = NormalDist().inv_cdf(0.5 + VolumeParameters().confidence / 2.0)
        name = arguments.previous.name
        found = cloud_change(new, previous, name, k, polygon, stable, registration)
    doubts += Verdict(mesh_doubts([s.path for s in sources], [s.mesh for s in sources], surfaces))
    facts = {
        **change_facts(found, k),
        "registration": None if registration is None else registration.facts,
        "verdict": (doubts + found.verdict).as_dict(),
        "objects": [dataclasses.asdict(one) for s in surfaces for one in s.objects[:MOST_OBJECTS]],
        "previous": surface_facts(sources[0], previous),
        "new": surface_facts(sources[1], new),
        "frame": frame_words(registration),
        "version": version(),
    }
    write_comparison(arguments, facts, found.change, folder)
    return facts


def registered(
    arguments: argparse.Namespace, sources: list[Source], stable: F64 | None
) -> tuple[Registration | None, list[CloudSurface]]:
    """Both surfaces, earlier first, the later one moved as the options say. Raises
    :class:`RegistrationError` where the ground does not tell how.
    """
    a = arguments
    if a.transform is not None and a.register is not None:
        raise ConfigurationError("--transform and --register each move the new cloud: choose one")
    if a.reach is not None and a.register != "icp":
        raise ConfigurationError("--reach belongs to --register icp", value=a.reach)
    found = None
    if a.transform is not None:
        facts = {"how": a.transform.name}
        verdict = read_transform_verdict(a.transform)
        found = Registration(
            read_transform(a.transform), a.transform.name, facts, tuple(verdict.doubts)
        )
    surfaces = [surface_of(a, sources[0], a.sigma_b)]
    if found is None:
        surfaces.append(surface_of(a, sources[1], a.sigma))
        found = found_by(a, surfaces, stable)
    if found is not None:
        surfaces = [surfaces[0], surface_of(a, moved(sources[1], found.transform), a.sigma)]
    return found, surfaces


def cleared(arguments: argparse.Namespace, surfaces: list[CloudSurface]) -> list[CloudSurface]:
    """Both surfaces without what stands on one of them alone."""
    if arguments.clean == "off":
        return surfaces
    fitted = site_lengths(Parameters(), size_of(surfaces[0]))
    options = surface_options(arguments, SurfaceParameters(ratio=1.0))
    return without_new_objects(surfaces, fitted, options)


def surface_of(arguments: argparse.Namespace, source: Source, sigma: float | None) -> CloudSurface:
    """The surface of one file; ``sigma`` m of its heights, None for that of both."""
    options = surface_options(arguments, SurfaceParameters(ratio=1.0))
    return make_surface(
        arguments, source, options, None, arguments.sigma if sigma is None else sigma
    )


def found_by(
    arguments: argparse.Namespace, surfaces: list[CloudSurface], stable: F64 | None
) -> Registration | None:
    """How the later of two surfaces comes to lie on the earlier one; None where nobody asked."""
    previous, new = surfaces
    if arguments.register is None:
        return None
    if arguments.register == "icp":
        return by_icp(new, previous, arguments.reach, stable)
    ground = pair_ground([new, previous])
    if ground is None:
        raise ConfigurationError(
            "too little of the two clouds is alike for --register height: give --transform"
        )
    return by_height(new, ground.unchanged if stable is None else named_part(ground, stable))


def moved(source: Source, T: Transform) -> Source:
    """A source moved by a transform. Raises :class:`ConfigurationError` for a mesh."""
    if source.mesh is not None:
        words = f"{source.path} is a mesh: --transform and --register move point clouds"
        raise ConfigurationError(words, value=str(source.path))
    cloud = dataclasses.replace(source.cloud, r=T.apply(source.cloud.r))
    return dataclasses.replace(source, cloud=cloud)


def change_facts(found: CloudChange, k: float) -> dict[str, Any]:
    """The change as plain values, named as those of surveys."""
    v = found.volume
    z = v.net_m3 / v.sigma_m3 if v.sigma_m3 > 0.0 else math.copysign(math.inf, v.net_m3)
    half = k * v.sigma_m3
    ground = found.ground
    return {
        "volume_m3": v.net_m3,
        "sigma_m3": v.sigma_m3,
        "interval_m3": [v.net_m3 - half, v.net_m3 + half],
        "confidence": VolumeParameters().confidence,
        "coverage_factor": k,
        "z": z,
        "p_value": math.erfc(abs(z) / math.sqrt(2.0)),
        "significant": abs(z) > k,
        "cut_m3": v.cut_m3,
        "sigma_cut_m3": v.sigma_cut_m3,
        "fill_m3": v.fill_m3,
        "sigma_fill_m3": v.sigma_fill_m3,
        "area_m2": v.area_m2,
        "base": v.base,
        "base_same_survey": False,
        "budget_m6": v.budget_m6,
        "sigma_holds": "noise of the points, what was not seen, and how the clouds were moved only",
        "centimetre_m3": 0.01 * v.area_m2,
        "stable_ground": {**dataclasses.asdict(ground), "effect_m3": ground.effect_m3},
        "level_of_detection": dataclasses.asdict(found.kept),
    }


def frame_words(registration: Registration | None) -> str:
    """How the new cloud came to lie on the earlier one."""
    if registration is None:
        return "as the files have it"
    own = {
        "icp": "new cloud turned and shifted onto the earlier one, point to plane",
        "height": "new cloud lifted to where the two are alike",
    }
    return own.get(registration.how, f"new cloud moved by {registration.how}")

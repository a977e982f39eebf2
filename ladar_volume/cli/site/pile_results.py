"""Piles for ``ladar_volume volume --piles``: outlines, errors and densities of the options, and
what the JSON says of each pile.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.cli.inputs.reading import Source
from ladar_volume.cli.volume_facts import volume_facts
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.sampling.objects_beside import beside_doubts, objects_within
from ladar_volume.io.results import finite
from ladar_volume.io.site.height_budget import read_budget, read_height_errors
from ladar_volume.io.site.outline_files import Outlines, read_outlines
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import HeightError, Material
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.piles.found_piles import found_piles
from ladar_volume.piles.pile_site import SiteTask
from ladar_volume.piles.pile_volumes import PileVolume, RefusedPile, SitePiles, piles_of
from ladar_volume.piles.tonnage import Tonnage, tonnage, total_tonnage

#: The word for piles that are found.
FOUND = "found"
#: Line of the budget from ``--height-sigma``.
GIVEN = "height_error"
#: Bases in words.
WORDS = {
    "ground": "ground around each pile ({kind})",
    "site_ground": "ground of the whole site ({kind})",
    "toe_plane": "plane through each toe line",
    "toe_quadratic": "quadratic through each toe line",
    "toe_tin": "triangulation of each toe line",
    "toe_lowest": "level of each toe line's lowest point",
    "toe_mean": "mean level of each toe line",
    "toe_highest": "level of each toe line's highest point",
    "level": "level {level:.3f} m",
    "plane": "given plane z = {0:.6g} + {1:.6g} x + {2:.6g} y",
    "second": "surface of {second}",
}


def height_errors(a: argparse.Namespace) -> tuple[HeightError, ...]:
    """Errors that heights share, of the options. Raises :class:`ConfigurationError`."""
    if a.correlation is not None and a.height_sigma is None:
        raise ConfigurationError("--correlation goes with --height-sigma")
    out: tuple[HeightError, ...] = ()
    if a.budget is not None:
        path = Path(a.budget)
        out = read_height_errors(path) if a.trajectory is None else read_budget(path)[0]
    if a.height_sigma is not None:
        if any(error.name == GIVEN for error in out):
            raise ConfigurationError(f"--budget has a line {GIVEN}, which --height-sigma is")
        length = math.inf if a.correlation is None else a.correlation
        out = (*out, HeightError(GIVEN, a.height_sigma, length))
    if out and a.frame == "scan":
        raise ConfigurationError("errors of heights go with --frame level")
    return out


def sigma_words(shared: Sequence[HeightError], flown: bool = False) -> str:
    """What a standard deviation holds; ``flown``: whether the trajectory is known."""
    own = "noise of the points and what lies between them"
    more = ["calibration and navigation along the trajectory"] if flown else []
    if shared:
        more.append(f"errors that heights share: {', '.join(e.name for e in shared)}")
    return f"{own}, and {', and '.join(more)}" if more else f"{own} only"


def error_facts(shared: Sequence[HeightError]) -> dict[str, Any]:
    """What the JSON says of errors that heights share, by name."""
    return {
        e.name: {
            "sigma_m": e.sigma_m,
            "correlation_m": None if math.isinf(e.correlation_m) else e.correlation_m,
        }
        for e in shared
    }


def common_material(a: argparse.Namespace) -> Material | None:
    """The material of all piles that name none. Raises :class:`ConfigurationError`."""
    if a.density is None and a.density_sigma is None:
        return None
    if a.piles is None or a.density is None:
        word = "--density goes with --piles" if a.piles is None else "--density-sigma alone"
        raise ConfigurationError(f"{word}: give --piles and --density")
    return Material("", a.density, math.nan if a.density_sigma is None else a.density_sigma)


def outlines_of(a: argparse.Namespace, sources: Sequence[Source]) -> Outlines | None:
    """The outlines of ``--piles FILE`` in the system of the points; None where none are given or
    they are to be found.
    """
    if a.piles is None or str(a.piles) == FOUND:
        return None
    cloud = sources[0].cloud
    extent = np.array([cloud.r[:, :2].min(axis=0), cloud.r[:, :2].max(axis=0)])
    return read_outlines(Path(a.piles), cloud.coordinates, extent)


def outline_facts(a: argparse.Namespace, outlines: Outlines) -> dict[str, Any]:
    """What the JSON says of the file of outlines."""
    return {
        "path": Path(a.piles).name,
        "system": outlines.system,
        "piles": len(outlines.piles),
        "ignored": outlines.ignored,
    }


def pile_volumes(
    a: argparse.Namespace,
    asked: SiteTask,
    outlines: Outlines | None,
    surfaces: Sequence[CloudSurface],
    progress: Callable[[str], None],
) -> SitePiles:
    """All piles, found where no outlines are given; ``asked`` : parameters and base."""
    base, parameters = asked.base, asked.parameters
    piles = found_piles(surfaces[0], parameters) if outlines is None else outlines.piles
    material = common_material(a)
    if material is not None:
        piles = [dataclasses.replace(p, material=p.material or material) for p in piles]
    second = surfaces[1] if len(surfaces) == 2 else None
    named = base in ("second", "level", "plane") or a.base is not None
    words = base_words(a, base, parameters)
    task = dataclasses.replace(asked, is_named=named, words=words, second=second)
    found = piles_of(surfaces[0], piles, task, progress)
    if outlines is not None:
        return found
    least, size = parameters.volume.min_body_m3, min(p.volume.net_m3 for p in found.piles)
    objects, within = surfaces[0].objects, objects_within(surfaces[0], found.inside_m2)
    beside = beside_doubts(objects, within, (least, size))
    return dataclasses.replace(found, verdict=found.verdict + Verdict(tuple(beside)))


def base_words(a: argparse.Namespace, base: str, parameters: Parameters) -> str:
    """The base in words."""
    kind = ("level", "plane", "quadric", "cubic")[parameters.ground.degree]
    v = parameters.volume
    second = "" if a.cloud_b is None else a.cloud_b.name
    words = WORDS[base]
    return words.format(*v.plane, kind=kind, level=v.level_m, second=second)


def pile_facts(
    site: SitePiles, a: argparse.Namespace, parameters: Parameters
) -> tuple[Verdict, dict[str, Any]]:
    """The verdict of all piles, each doubt with the name of its pile, and a row for each."""
    doubts = tuple(
        Doubt(d.name, f"{pile.pile.name}: {d.text}", d.value)
        for pile in site.piles
        for d in pile.verdict.doubts
    )
    rows = [row_of(pile, parameters) for pile in site.piles]
    rows += [refused_row(each) for each in site.refused_piles]
    facts: dict[str, Any] = {"piles": rows}
    whole = total_of(site)
    if whole is not None:
        facts |= mass_facts(whole)
    return Verdict(doubts) + site.verdict, facts


def row_of(pile: PileVolume, parameters: Parameters) -> dict[str, Any]:
    """What the JSON says of a pile."""
    material = pile.pile.material
    facts = volume_facts(pile.volume, parameters)
    mass = None
    if material is not None:
        mass = tonnage(pile.volume.net_m3, pile.volume.sigma_m3, material)
    return {
        "name": pile.pile.name,
        "material": None if material is None else material.name or None,
        **facts,
        **({} if mass is None or material is None else mass_facts(mass, material)),
        "height_m": pile.height_m,
        "top_m": pile.top_m,
        "bases": {
            name: {"net_m3": finite(b.net_m3), "sigma_m3": finite(b.sigma_m3), "why": b.why or None}
            for name, b in pile.bases.items()
        },
        "outline": pile.pile.ring.tolist(),
        "verdict": pile.verdict.as_dict(),
    }


def refused_row(refused: RefusedPile) -> dict[str, Any]:
    """A pile without a volume."""
    reason = {"name": refused.error.reason or "refused", "text": str(refused.error), "value": None}
    return {
        "name": refused.pile.name,
        "net_m3": None,
        "outline": refused.pile.ring.tolist(),
        "verdict": {"status": "refused", "reasons": [reason]},
    }


def mass_facts(mass: Tonnage, material: Material | None = None) -> dict[str, Any]:
    """What the JSON says of tonnes."""
    unknown = math.isnan(mass.by_density_t)
    own = {}
    if material is not None:
        sigma = material.sigma_t_m3
        own = {
            "density_t_m3": material.density_t_m3,
            "sigma_density_t_m3": None if math.isnan(sigma) else sigma,
        }
    return {
        **own,
        "mass_t": mass.mass_t,
        "sigma_mass_t": mass.sigma_t,
        "sigma_mass_holds": "volume only" if unknown else "volume and density",
    }


def total_of(site: SitePiles) -> Tonnage | None:
    """Tonnes of all piles; None where one of them has no density. What the volumes share of their
    errors counts alike in all materials.
    """
    parts, names = [], []
    for pile in site.piles:
        material = pile.pile.material
        if material is None:
            return None
        parts.append(tonnage(pile.volume.net_m3, pile.volume.sigma_m3, material))
        names.append(material.name or f"{material.density_t_m3:g}")
    alone = math.hypot(*(pile.volume.sigma_m3 for pile in site.piles))
    by_volume = math.hypot(*(part.by_volume_t for part in parts))
    return total_tonnage(parts, names, by_volume * site.total.sigma_m3 / max(alone, 1e-300))

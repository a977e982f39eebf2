"""Lengths of base and outline for sites of any size.

The defaults of ``volume`` are lengths of a stockpile yard: a body rises 15 cm, its toe lies within
1 m, the ground within 10 m. On a table they span the scene, and where points lie farther apart than
they are long they reach none. Here they follow the site: all shrink with the extent of a site
smaller than :data:`YARD_M`; on a coarse one the height grows with the noise, and the widths with
the spacing, but no more than with the extent. Between these they stay as they are, so that
volumes of a yard can be compared.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.model.parameters import Parameters
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.tin.relevant import size_kernel

#: Side, m, of the square as large as a site below which the lengths shrink with it.
YARD_M = 12.0
#: A body rises at least so many standard deviations of one height.
RISE = 5.0
#: The margin around a body is at least so many spacings of the points wide: the toe is read there.
MARGIN = 2.5
HEIGHTS, WIDTHS = ("object_height_m",), ("outline_margin_m", "ground_ring_m")


@dataclass(frozen=True)
class SiteSize:
    """area_m2 : sampled · vertices : on it · sigma_m : of one height, NaN where it is not known"""

    area_m2: float
    vertices: int
    sigma_m: float


def size_of(surface: CloudSurface) -> SiteSize:
    """The size of the site of a surface."""
    tin = surface.representation.tin
    area, _ = size_kernel(tin.vertices, tin.triangles, tin.relevant)
    noise = math.nan if surface.sigma_m is None else float(np.median(surface.sigma_m))
    return SiteSize(float(area), int(np.count_nonzero(vertex_mask(tin, tin.relevant))), noise)


def site_lengths(parameters: Parameters, site: SiteSize, named: Collection[str] = ()) -> Parameters:
    """The parameters with the lengths of ``volume`` for this site, and the smallest further body.
    What the user ``named`` (keys of ``volume``) stays as it is.
    """
    p = parameters.volume
    if not site.area_m2 > 0:
        return parameters
    up = across = most = math.sqrt(site.area_m2) / YARD_M
    if most > 1.0:
        up = across = 1.0
        if p.object_height_m > 0 and math.isfinite(site.sigma_m):
            up = min(max(1.0, RISE * site.sigma_m / p.object_height_m), most)
        if p.outline_margin_m > 0:
            spacing = math.sqrt(site.area_m2 / site.vertices)
            across = min(max(1.0, MARGIN * spacing / p.outline_margin_m), most)
    fitted = {name: up * getattr(p, name) for name in HEIGHTS}
    fitted |= {name: across * getattr(p, name) for name in WIDTHS}
    fitted["min_body_m3"] = up * across**2 * p.min_body_m3
    kept = {name: value for name, value in fitted.items() if name not in named}
    return dataclasses.replace(parameters, volume=dataclasses.replace(p, **kept))


def named_lengths(settings: Collection[str]) -> list[str]:
    """Keys of ``volume`` among settings ``volume.key=value`` of the user."""
    return [text.partition("=")[0].strip().partition(".")[2] for text in settings]


def length_facts(parameters: Parameters) -> dict[str, float]:
    """The lengths, m, and the smallest further body, m³, that a volume was found with."""
    names = (*HEIGHTS, *WIDTHS, "min_body_m3")
    return {name: float(getattr(parameters.volume, name)) for name in names}

"""Plants on the ground and on the body: told from how patches scatter, or known to the user."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.ground.heights import height_above
from ladar_volume.model.parameters import VolumeParameters
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.model.verdict import Doubt

#: Height of what grows, over its scatter.
COVER = 4.0
#: Patches that scatter so many times as much as the body's median hold more than their surface.
BUSH = 2.5
#: A patch across a break of loose material, as a crest or a toe, scatters by 0.065 of its radius.
BREAK = 0.08


class KnownCover(NamedTuple):
    """What the user says of plants. own_ground : whether the base is the ground of the survey ·
    ground, body : whether it is said of them · shift_m : height of the plants on the ground minus
    that of those on the body · sigma_m : its standard deviation
    """

    own_ground: bool
    ground: bool
    body: bool
    shift_m: float
    sigma_m: float

    def correction(self, tin: Tin, base: Plane, part: F64, least_m: float) -> tuple[float, float]:
        """What to add to the volume for the plants, m³, and its standard deviation. part : (m,) m²
        of each triangle that counts · least_m : height above the base that belongs to the body.
        """
        if self.shift_m == 0.0 and self.sigma_m == 0.0:
            return 0.0, 0.0
        area, toe = float(part.sum()), 0.0
        if self.own_ground:
            area, toe = body_area(tin, base, part, least_m)
        return self.shift_m * area, math.hypot(self.sigma_m * area, self.shift_m * toe)


def known_cover(v: VolumeParameters, own_ground: bool) -> KnownCover:
    """The parameters' plants. own_ground : whether the base is the ground of the survey; another
    base has no plants.
    """
    ground = (*v.ground_cover_m, 0.0, 0.0)[:2] if own_ground else (0.0, 0.0)
    body = (*v.body_cover_m, 0.0, 0.0)[:2]
    return KnownCover(
        own_ground,
        bool(v.ground_cover_m),
        bool(v.body_cover_m),
        ground[0] - body[0],
        math.hypot(ground[1], body[1]),
    )


def body_area(tin: Tin, base: Plane, part: F64, least_m: float) -> tuple[float, float]:
    """Plan area of a body, m², and how much of it is its toe. What counts has a margin of ground,
    where plants move surface and base alike: the area above the base is told from those above two
    heights. part : (m,) m² of each triangle.
    """
    height = np.abs(height_above(tin.vertices, base))[tin.triangles].mean(axis=1)
    once, twice = (float(part[height > k * least_m].sum()) for k in (1.0, 2.0))
    area = min(2.0 * once - twice, float(part.sum()))
    return area, area - once


def cover_sigma(
    ground_m: float, body_m: float, area_m2: float, volume_m3: float
) -> tuple[float, list[Doubt]]:
    """What plants that nobody told of do to a volume, m³, and the doubt. ground_m, body_m : by how
    much the ground scatters more than the body, and the body more than the ground.
    """
    more = ground_m or body_m
    if more == 0.0:
        return 0.0, []
    sigma = COVER * more * area_m2
    if ground_m > 0.0:
        words = (
            f"the ground scatters {1e3 * more:.2g} mm more than the body, as grass and plants do: "
            f"the base may lie above the soil by some {1e2 * COVER * more:.2g} cm, {sigma:.3g} m³ "
            "of sigma; mow, give volume.base level or plane, survey the empty site, or say with "
            "volume.ground_cover_m how high it is (0, 0: bare)"
        )
    else:
        sigma = min(sigma, abs(volume_m3))  # plants are part of what was measured
        words = (
            f"the body scatters {1e3 * more:.2g} mm more than bare ground, as plants and rough "
            f"material do: plants would make it {sigma:.3g} m³ too large, which is in sigma; look "
            "at it, and mow, or say with volume.body_cover_m how high they are (0, 0: rough, but "
            "bare)"
        )
    return sigma, [Doubt("vegetation", words, more)]


def bush_volume(tin: Tin, part: F64, scatter_m: F64, on_face: Bool, radius_m: float) -> float:
    """What single plants, and other things lower than what is left out as an object, may add to a
    body, m³: where it scatters far more than usual, and than a break of its slope makes, by how
    much more. Along steep faces patches scatter that do not bend as sharply.

    part : (m,) m² of each triangle that counts · scatter_m : (n,) RMS residual of the patch of each
    vertex, m · on_face : (n,) vertices on steep faces · radius_m : how far a patch reaches
    """
    own = np.flatnonzero(part > 0.0)
    if not len(own):
        return 0.0
    scatter = scatter_m[tin.triangles[own]].mean(axis=1)
    usual = float(np.median(scatter))
    far = np.flatnonzero(scatter > max(BUSH * usual, BREAK * radius_m))
    if len(far) and on_face.any():
        corners = tin.vertices[tin.triangles[own[far]]]
        away = np.asarray(cKDTree(tin.vertices[on_face]).query(corners)[0])
        far = far[away.min(axis=1) > radius_m]
    return float(part[own[far]] @ np.sqrt(scatter[far] ** 2 - usual**2))


def bush_doubts(bush_m3: float, sigma_m3: float) -> list[Doubt]:
    """Whether plants on the body hold more than a sigma."""
    if not bush_m3 > sigma_m3:
        return []
    words = (
        f"places on the body scatter more than {BUSH:g} times as much as the rest, as shrubs, "
        f"rubble and people do: they may make it some {bush_m3:.3g} m³ too large, which is in "
        "sigma; look at them, clear them, or say with volume.body_cover_m that they belong to it "
        "(0, 0)"
    )
    return [Doubt("vegetation", words, bush_m3)]

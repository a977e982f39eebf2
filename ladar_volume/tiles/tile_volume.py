"""Cut, fill and net volume of one tile above a level or a plane, and the sums of all tiles.

Each triangle is counted in one tile. The gradient by a vertex' height is complete in the tile that
the vertex lies in, since that tile knows all triangles round its vertices: nothing is exchanged,
and variances add up. They are those of :mod:`ladar_volume.clouds.cloud_volume` for a surface of all
points, without its correction near the base.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.cloud_noise import cloud_noise
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.ground.polynomial import design_surface, height_above
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.records import F64, Bool
from ladar_volume.tiles.tile_stars import TileStars
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.relevant import relevant_triangles
from ladar_volume.volume.near_base import near_triangles
from ladar_volume.volume.prismoids import prismoids


@dataclass(frozen=True)
class TileTask:
    """What is asked of every tile.

    base : coefficients of the base, one for a level, three for a plane, m · relevant : which
    triangles count, with the limits ``max_edge_m`` and ``max_circumdiameter_m`` · sigma_m :
    standard deviation of the heights, None where it is to be estimated tile by tile
    """

    base: tuple[float, ...]
    relevant: str = "all"
    max_edge_m: float = math.inf
    max_circumdiameter_m: float = math.inf
    sigma_m: float | None = None


@dataclass(frozen=True)
class TileSums:
    """What a tile gives to the whole.

    points, vertices, triangles : counted in it · cut_m3, fill_m3, area_m2 · squares_m4 :
    sums of the squared gradients of net, cut and fill by the heights of its vertices · sigma_m : of
    these heights, None where it is not known · near_m2 : area within reach of the noise of the base
    · rounds : how often it was triangulated
    """

    points: int
    vertices: int
    triangles: int
    cut_m3: float
    fill_m3: float
    area_m2: float
    squares_m4: tuple[float, float, float]
    sigma_m: float | None
    near_m2: float
    rounds: int


def noise_of_tile(points: F64) -> float | None:
    """Standard deviation, m, of the heights of points (n, 3); None where they are too few."""
    try:
        return cloud_noise(points).sigma_m
    except SurfaceError:
        return None


def tile_sums(stars: TileStars, points: F64, task: TileTask) -> TileSums:
    """The sums of a tile with points (n, 3) m."""
    tin, base = stars.tin, design_surface(list(task.base))
    sigma = task.sigma_m if task.sigma_m is not None else noise_of_tile(points)
    counts = relevant_triangles(tin, task.relevant, task.max_edge_m, task.max_circumdiameter_m)
    own, star = stars.counted & counts, stars.star & counts
    cut = fill = area = near = 0.0
    squares = (0.0, 0.0, 0.0)
    if own.any():
        solid = prismoids(tin, base, own)
        cut, fill, area = solid.cut_m3, solid.fill_m3, solid.area_m2
        near = near_area(stars, own, height_above(tin.vertices, base), sigma)
    if star.any():
        round_own = prismoids(tin, base, star)
        g = (round_own.gradient_net, round_own.gradient_cut, round_own.gradient_fill)
        net_m4, cut_m4, fill_m4 = (
            float((each[stars.own, 2] ** 2 / stars.shared[stars.own]).sum()) for each in g
        )
        squares = (net_m4, cut_m4, fill_m4)
    return TileSums(
        len(points),
        int(np.count_nonzero(stars.own)),
        int(np.count_nonzero(own)),
        cut,
        fill,
        area,
        squares,
        sigma,
        near,
        stars.rounds,
    )


def near_area(stars: TileStars, own: Bool, height: F64, sigma: float | None) -> float:
    """Area, m², of the tile's triangles that the noise may carry across the base."""
    if not sigma:
        return 0.0
    triangles = stars.tin.triangles[own]
    near = near_triangles(triangles, height, sigma**2 / stars.shared)
    return float(footprint_areas(stars.tin.vertices, triangles)[near].sum())


def whole_volume(tiles: Iterable[TileSums], base: str) -> CloudVolume:
    """The volume of all tiles; sums are exactly rounded, so the order of the tiles is no matter.
    Where a tile cannot tell its noise, the largest of the others is taken. Raises
    :class:`VolumeError` where no triangle counts.
    """
    every = list(tiles)
    if not any(t.triangles for t in every):
        raise VolumeError("no triangle counts: widen the limit", reason="volume_no_triangle")
    known = [t.sigma_m for t in every if t.sigma_m is not None]
    other = max(known) if known else math.nan
    weight = [(other if t.sigma_m is None else t.sigma_m) ** 2 for t in every]
    net, cut, fill = (
        math.fsum(w * t.squares_m4[k] for w, t in zip(weight, every, strict=True)) for k in range(3)
    )
    cut_m3, fill_m3 = math.fsum(t.cut_m3 for t in every), math.fsum(t.fill_m3 for t in every)
    return CloudVolume(
        cut_m3,
        fill_m3,
        cut_m3,
        fill_m3,
        0.0 if known else math.nan,
        math.fsum(t.near_m2 for t in every),
        math.sqrt(net),
        math.sqrt(cut),
        math.sqrt(fill),
        math.fsum(t.area_m2 for t in every),
        base,
        False,
        {"noise": net},
    )

"""The steps of the surface of all tiles: where no edge is a steep step nothing stands on it."""

from __future__ import annotations

from typing import NamedTuple

from ladar_volume.math.kernels import kernel
from ladar_volume.model.records import F64, I32
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.tile_batches import TiledCloud, ask
from ladar_volume.tiles.tile_store import Tile
from ladar_volume.tiles.tile_surface import EVERY, surface_of
from ladar_volume.tiles.tile_work import Workers
from ladar_volume.tiles.tiled_points import DealtOut
from ladar_volume.volume.field_checks.standing_objects import STEEP


class Highest(NamedTuple):
    """count : of steps · rise : of the highest, m · x, y : of its middle, m"""

    steps: int
    rise: float
    x: float
    y: float


@kernel
def highest_step(triangles: I32, vertices: F64, step_m: float, steep: float) -> Highest:
    """The edges of triangles (m, 3) that are higher than a step, m, and steeper than a slope; those
    that two triangles have count twice.
    """
    steps, most, x, y = 0, 0.0, 0.0, 0.0
    for t in range(len(triangles)):
        for k in range(3):
            a, b = triangles[t, k], triangles[t, (k + 1) % 3]
            rise = abs(vertices[b, 2] - vertices[a, 2])
            dx, dy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
            if rise > step_m and rise * rise > steep * steep * (dx * dx + dy * dy):
                steps += 1
                if rise > most:
                    most = rise
                    x = 0.5 * (vertices[a, 0] + vertices[b, 0])
                    y = 0.5 * (vertices[a, 1] + vertices[b, 1])
    return Highest(steps, most, x, y)


def steps_of(of: TiledCloud, tile: Tile, step_m: float) -> Highest:
    """The steps round the vertices of a tile."""
    tin = surface_of(of.index, EVERY, tile).tin
    return Highest(*highest_step(tin.triangles, tin.vertices, step_m, STEEP))


def highest_of_all(workers: Workers, points: DealtOut, step_m: float) -> Highest | None:
    """The highest step between points; None for no step."""
    of = TiledCloud(points.index, EVERY)
    found = ask(workers, of, steps_of, [(step_m,)] * len(of.tiles))
    highest = max(found, key=lambda one: one.rise)
    return highest if highest.steps else None


def step_doubt(highest: Highest, step_m: float) -> Doubt:
    """Something may stand on the surface, and was not searched for."""
    words = (
        f"the surface has steps above {step_m:.2g} m, the highest of {highest.rise:.3g} m about "
        f"({highest.x:.1f}, {highest.y:.1f}) m: what stands on it, as machines, walls and trees "
        "do, has too many points to be taken out and is counted; take these out of the cloud, as "
        "with --classes, or set volume.objects to count where they are of the body"
    )
    return Doubt("tiles_not_judged", words, highest.rise)

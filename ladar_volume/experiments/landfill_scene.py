"""The landfill excavation of seed 003, simulated: three layers of 2 m, rubble walls of which one
overhangs, six spheres, two instruments.

Printed are the layer (2 m), the angular step (0.25°), the accuracy of a point (1 cm), the volume of
the second body (16 m³), six spheres around the pit of which four were used, and more than 12
tacheometer points on each. Everything else is chosen here, and said so in docs/study_landfill.md.

Frame: map, z up, the middle of the first layer's opening is the origin. Both surfaces of a layer
share every vertex outside its opening, so their meshes enclose the body exactly, and its volume is
known.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.mesh.tetrahedra import signed_tetrahedra
from ladar_volume.model.errors import SimulationError
from ladar_volume.model.records import F64, I32, I64

#: Layers that are measured, their depth, m, and the volume of the smooth body, m³; the rubble
#: changes it by some dm³.
LAYERS, LAYER_M, SMOOTH_M3 = 3, 2.0, 16.0
STEP_RAD, RANGE_SIGMA_M = np.radians(0.25), 0.01
#: Plan of a layer's opening: ratio of its half axes, and how far one wall hangs over the floor, m.
RATIO, LEAN_M = 1.15, 0.35
#: The floor that the excavator keeps free around the opening, and the walls of the pit above: half
#: width, m, and slope, m out per m up.
FREE_M, WALL_SLOPE, GROUND_M = 3.4, 0.25, 9.0
#: Two octaves of rubble: sd of the displacement in each direction, m, and correlation length, m.
RUBBLE = ((0.04, 0.45), (0.012, 0.12))
SPHERES, SPHERE_M, TACHEOMETER_POINTS, TACHEOMETER_SIGMA_M = 6, 0.1, 14, 0.003
#: Scanner above the floor it stands on: before a layer is dug, and after. Lower than the layer is
#: deep it would not see the ground around.
HEAD_M = (1.8, 2.7)
COLUMNS = 360


@dataclass(frozen=True)
class Layer:
    """One layer before and after: meshes (vertices (n, 3) m, triangles), the exact volume between
    them, m³, the polygon (c, 2) m around its opening, the scanner's two places (3,) m, and the
    spheres' centres (6, 3) m
    """

    before: tuple[F64, I32]
    after: tuple[F64, I32]
    volume_m3: float
    polygon: F64
    scanners: tuple[F64, F64]
    spheres: F64


@dataclass(frozen=True)
class RawScan:
    """A scan in its scanner's own frame, which is levelled, its heading unknown: surface points (n,
    3) m · points on spheres (k, 3) m, and the number of each one's sphere (k,) · to_map : angle,
    rad, and place (3,) m, which the study does not use
    """

    surface: F64
    on_spheres: F64
    sphere: I64
    heading_rad: float
    scanner_map: F64


def rubble(points: F64, seed: int) -> F64:
    """Displacements (n, 3) m of points (n, 3): smooth random vector fields, the same wherever a
    point is asked for again.
    """
    out = np.zeros_like(points)
    for octave, (sd, length) in enumerate(RUBBLE):
        rng = np.random.default_rng([seed, 31, octave])
        wave, phase = rng.standard_normal((48, 3)) / length, rng.uniform(0.0, 2.0 * np.pi, (48, 3))
        angle = points @ wave.T
        for k in range(3):
            out[:, k] += sd * np.sqrt(2.0 / 48) * np.sin(angle + phase[:, k]).sum(axis=1)
    return out


def curve(half: float, lean: float, z: float, power: float = 4.0) -> F64:
    """A closed row (COLUMNS, 3) of points: a rounded rectangle, half widths ``half`` in y and RATIO
    times that in x, moved by lean.
    """
    turn = 2.0 * np.pi * np.arange(COLUMNS) / COLUMNS
    c, s = np.cos(turn), np.sin(turn)
    r = half / ((np.abs(c) / RATIO) ** power + np.abs(s) ** power) ** (1.0 / power)
    return np.stack([r * c + lean, r * s, np.full(COLUMNS, z)], axis=1)


def area_factor(power: float = 4.0) -> float:
    """Area of the polygon of a row over the square of its half width."""
    row = curve(1.0, 0.0, 0.0, power)
    after = np.roll(row, -1, axis=0)
    return 0.5 * float((row[:, 0] * after[:, 1] - row[:, 1] * after[:, 0]).sum())


def rows_to_mesh(rows: list[F64], seed: int) -> tuple[F64, I32]:
    """Rows from the outside inwards, closed by their last one's middle, displaced by the rubble;
    triangles counter-clockwise from above.
    """
    points = np.concatenate([*rows, rows[-1].mean(axis=0)[None]])
    k = np.arange(COLUMNS)
    after, parts = (k + 1) % COLUMNS, []
    for i in range(len(rows) - 1):
        a, b = i * COLUMNS, (i + 1) * COLUMNS
        parts += [
            np.stack([a + k, a + after, b + k], axis=1),
            np.stack([a + after, b + after, b + k], axis=1),
        ]
    last = (len(rows) - 1) * COLUMNS
    parts.append(np.stack([last + k, last + after, np.full(COLUMNS, len(points) - 1)], axis=1))
    return points + rubble(points, seed), np.concatenate(parts).astype(np.int32)


def make_layer(number: int, seed: int) -> Layer:
    """Layer 0, 1 or 2, as deep below the ground as the layers before it."""
    if not 0 <= number < LAYERS:
        raise SimulationError(f"there are layers 0 to {LAYERS - 1}, not {number}", value=number)
    top, key = -LAYER_M * number, 10 * seed + number
    half = float(np.sqrt(SMOOTH_M3 / (LAYER_M * area_factor())))
    steps = np.linspace(0.0, 1.0, 60)[1:]
    around = [curve(w, 0.0, 0.0) for w in np.geomspace(GROUND_M, FREE_M - WALL_SLOPE * top, 60)]
    walls = (
        [
            curve(FREE_M + WALL_SLOPE * (z - top), 0.0, z)
            for z in np.linspace(0.0, top, 2 + int(-top / 0.05))[1:]
        ]
        if number
        else []
    )
    free = [curve(w, 0.0, top) for w in np.linspace(FREE_M, half, 50)[1:]]
    inward = [curve(half * (1.0 - s), 0.0, top) for s in steps[:-1]]
    down = [curve(half, -LEAN_M * s, top - LAYER_M * s) for s in steps]
    floor = [curve(half * (1.0 - s), -LEAN_M, top - LAYER_M) for s in steps[:-1]]
    common = [*around, *walls, *free]
    before, after = (rows_to_mesh([*common, *more], key) for more in (inward, [*down, *floor]))
    n = (len(common) - 1) * COLUMNS * 2  # triangles that both share
    apex = np.array([0.0, 0.0, top])
    volume = sum(
        sign * float(signed_tetrahedra(v, t[n:], apex).sum())
        for sign, (v, t) in ((1.0, before), (-1.0, after))
    )
    turn = np.radians(np.array([10.0, 75.0, 130.0, 190.0, 250.0, 310.0]))
    out = FREE_M - WALL_SLOPE * top + 1.2
    rng = np.random.default_rng([seed, 7])
    spheres = np.stack(
        [out * RATIO * np.cos(turn), out * np.sin(turn), rng.uniform(0.9, 1.7, SPHERES)], axis=1
    )
    ring = curve(half + 0.25, 0.0, top)[::12, :2]
    places = (
        np.array([0.3, -0.2, top + HEAD_M[0]]),
        np.array([0.1, 0.15, top - LAYER_M + HEAD_M[1]]),
    )
    return Layer(before, after, volume, ring, places, spheres)


def directions() -> F64:
    """Unit vectors (n, 3) of the scanner's grid: 0.25° in azimuth and elevation, straight down to
    60° up.
    """
    azimuth = np.arange(0.0, 2.0 * np.pi - 1e-9, STEP_RAD)
    elevation = np.arange(-0.5 * np.pi + 0.5 * STEP_RAD, np.radians(60.0), STEP_RAD)
    a, e = (g.ravel() for g in np.meshgrid(azimuth, elevation))
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)


def to_spheres(origin: F64, rays: F64, centres: F64) -> tuple[F64, I64]:
    """Distance (n,) m along unit rays (n, 3) to the first of the spheres, infinite where none is
    met, and its number (n,).
    """
    best, which = np.full(len(rays), np.inf), np.full(len(rays), -1, np.int64)
    for k, c in enumerate(centres):
        along = rays @ (c - origin)
        rest = float((c - origin) @ (c - origin)) - along**2
        hit = (rest < SPHERE_M**2) & (along > 0.0)
        t = np.where(hit, along - np.sqrt(np.maximum(SPHERE_M**2 - rest, 0.0)), np.inf)
        which, best = np.where(t < best, k, which), np.minimum(best, t)
    return best, which


def scan(
    mesh: tuple[F64, I32],
    scanner: F64,
    spheres: F64,
    rng: np.random.Generator,
    sigma_m: float = RANGE_SIGMA_M,
) -> RawScan:
    """One scan of a surface and spheres (k, 3), with independent range noise, from a levelled
    scanner of random heading.
    """
    o3d: Any = importlib.import_module("open3d")  # loaded where rays are cast
    heading = float(rng.uniform(0.0, 2.0 * np.pi))
    own = directions()
    c, s = np.cos(heading), np.sin(heading)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    rays = own @ R.T
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(
        o3d.core.Tensor((mesh[0] - scanner).astype(np.float32)),
        o3d.core.Tensor(mesh[1].astype(np.uint32)),
    )
    hit = caster.cast_rays(
        o3d.core.Tensor(np.concatenate([np.zeros_like(rays), rays], axis=1).astype(np.float32)),
        nthreads=1,
    )
    distance = hit["t_hit"].numpy().astype(np.float64)
    near, which = to_spheres(scanner, rays, spheres)
    which = np.where(near < distance, which, -1)
    distance = np.minimum(near, distance)
    seen = np.isfinite(distance)
    points = own[seen] * (distance[seen] + sigma_m * rng.standard_normal(int(seen.sum())))[:, None]
    ball = which[seen] >= 0
    return RawScan(points[~ball], points[ball], which[seen][ball], heading, scanner)


def tacheometer(spheres: F64, station: F64, rng: np.random.Generator) -> tuple[F64, I64]:
    """Points (k, 3) m measured without reflector on the near halves of the spheres from a station,
    and the number of each one's sphere.
    """
    points, number = [], []
    for k, c in enumerate(spheres):
        towards = (station - c) / np.linalg.norm(station - c)
        u = rng.standard_normal((200, 3))
        u /= np.linalg.norm(u, axis=1)[:, None]
        at = c + SPHERE_M * u[u @ towards > 0.25][:TACHEOMETER_POINTS]
        beam = (at - station) / np.linalg.norm(at - station, axis=1)[:, None]
        points.append(at + TACHEOMETER_SIGMA_M * rng.standard_normal((len(at), 1)) * beam)
        number.append(np.full(len(at), k))
    return np.concatenate(points), np.concatenate(number).astype(np.int64)

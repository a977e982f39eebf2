"""A rotating scanner before a scene of surfaces with a formula: sloping ground, houses and boxes, a
sphere, a mast, and a bush that is no surface. Rays are met in closed form, and the distance of any
point from the surfaces is exact. Nothing of the package is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.truth import F64, I64, Mask

FAR_M, NEAREST_M, LONGEST_M = 0.5, 0.6, 100.0
#: A beam goes this far into the bush in the mean, m.
LEAVES_M = 0.5
#: A turn, and the pause before the next that is kept, s.
SWEEP_S, PAUSE_S = 0.1, 0.5
#: Elevations of the lowest and highest ring and returns of a ring in a turn, by number of rings.
SCANNERS = {
    16: (-15.0, 15.0, 1500),
    32: (-25.0, 15.0, 800),
    64: (-22.5, 22.5, 512),
    128: (-22.5, 22.5, 300),
}
SURFACE, BUSH, STRAY = 0, 1, 2


@dataclass(frozen=True)
class Body:
    """meet : origins and unit directions (n, 3) → range (n,) m, inf where missed · distance :
    points (k, 3) → (k,) m from the surface
    """

    meet: Callable[[F64, F64], F64]
    distance: Callable[[F64], F64]


@dataclass(frozen=True)
class Case:
    """motion : standing, rolling or flying · noise_m : of the range · jitter_deg : of the
    elevation, one sigma each · step_m : of rounding · copies : of every point · stray : share of
    outliers, half of them along their beams, half anywhere
    """

    rings: int
    motion: str
    noise_m: float
    jitter_deg: float = 0.0
    step_m: float = 1e-6
    copies: int = 1
    stray: float = 0.01

    @property
    def name(self) -> str:
        """For a table."""
        return (
            f"{self.rings} rings {self.motion}, {1e3 * self.noise_m:g} mm, {self.jitter_deg:g} deg"
            f", rounded to {1e3 * self.step_m:g} mm, x{self.copies}"
        )


@dataclass(frozen=True)
class Scan:
    """r (n, 3) m, in random order · label (n,) : SURFACE, BUSH or STRAY · distance (n,) m from the
    true surfaces · far (n,) : strays farther than 0.5 m from all surfaces and the bush
    """

    r: F64
    label: I64
    distance: F64
    far: Mask
    scene: list[Body]


def plane(normal: F64, offset: float) -> Body:
    """n·x = offset."""

    def meet(o: F64, d: F64) -> F64:
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (offset - o @ normal) / (d @ normal)
        return np.where(t > 0, t, np.inf)

    return Body(meet, lambda x: np.abs(x @ normal - offset))


def box(centre: F64, half: F64, yaw: float) -> Body:
    """Turned about the vertical."""
    R = np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])

    def meet(o: F64, d: F64) -> F64:
        a, b = (o - centre) @ R.T, d @ R.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t1, t2 = (-half - a) / b, (half - a) / b
        enter, leave = np.minimum(t1, t2).max(axis=1), np.maximum(t1, t2).min(axis=1)
        return np.where((enter <= leave) & (enter > 0), enter, np.inf)

    def distance(x: F64) -> F64:
        q = np.abs((x - centre) @ R.T) - half
        out = np.linalg.norm(np.maximum(q, 0.0), axis=1)
        return np.where(out > 0, out, -q.max(axis=1))

    return Body(meet, distance)


def through(o: F64, d: F64, centre: F64, radius: float) -> tuple[F64, F64]:
    """Ranges (n,) at which rays enter and leave a sphere, inf where they miss it."""
    along = np.einsum("ni,ni->n", centre - o, d)
    square = radius**2 - np.sum((centre - o) ** 2, axis=1) + along**2
    chord = np.sqrt(np.maximum(square, 0.0))
    hit = (square > 0) & (along - chord > 0)
    return np.where(hit, along - chord, np.inf), np.where(hit, along + chord, np.inf)


def sphere(centre: F64, radius: float) -> Body:
    """A ball."""
    return Body(
        lambda o, d: through(o, d, centre, radius)[0],
        lambda x: np.abs(np.linalg.norm(x - centre, axis=1) - radius),
    )


def mast(foot: F64, radius: float, top: float) -> Body:
    """An upright cylinder from below the ground to the height ``top``, with a lid."""

    def meet(o: F64, d: F64) -> F64:
        a, b = o[:, :2] - foot[:2], d[:, :2]
        bb = np.maximum(np.sum(b**2, axis=1), 1e-30)
        ab = np.sum(a * b, axis=1)
        square = ab**2 - bb * (np.sum(a**2, axis=1) - radius**2)
        t = (-ab - np.sqrt(np.maximum(square, 0.0))) / bb
        z = o[:, 2] + t * d[:, 2]
        side = np.where((square > 0) & (t > 0) & (z < top), t, np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (top - o[:, 2]) / d[:, 2]
            inside = np.sum((a + s[:, None] * b) ** 2, axis=1) < radius**2
        return np.minimum(side, np.where((s > 0) & inside, s, np.inf))

    def distance(x: F64) -> F64:
        rho = np.linalg.norm(x[:, :2] - foot[:2], axis=1) - radius
        q = np.column_stack([rho, x[:, 2] - top])
        out = np.linalg.norm(np.maximum(q, 0.0), axis=1)
        return np.where(out > 0, out, -q.max(axis=1))

    return Body(meet, distance)


def scene(rng: np.random.Generator) -> tuple[list[Body], F64, float]:
    """Bodies, and centre and radius of the bush; no two seeds have the same."""
    slope = np.array([*rng.uniform(-0.06, 0.06, 2), 1.0])
    bodies = [plane(slope / np.linalg.norm(slope), 0.0)]
    turn = rng.uniform(0, 2 * np.pi)
    around = turn + 2 * np.pi * (np.arange(8) + rng.uniform(-0.15, 0.15, 8)) / 8
    away = rng.uniform([12, 10, 5, 4, 5, 6, 6, 15], [18, 15, 8, 6, 8, 9, 8, 20])
    at = np.column_stack([away * np.cos(around), away * np.sin(around), np.zeros(8)])
    at[:, 2] = -at @ slope
    bodies.append(box(at[0] + [0, 0, 2.0], np.array([6.0, 3.0, 6.0]), rng.uniform(0, np.pi)))
    bodies.append(box(at[1] + [0, 0, 1.5], np.array([4.0, 2.0, 3.0]), rng.uniform(0, np.pi)))
    bodies.append(box(at[2], np.array([1.0, 0.6, 1.2]), rng.uniform(0, np.pi)))
    bodies.append(box(at[3], np.array([0.5, 0.5, 0.9]), rng.uniform(0, np.pi)))
    bodies.append(sphere(at[4] + [0, 0, 1.0], rng.uniform(0.8, 1.3)))
    bodies.append(mast(at[5], rng.uniform(0.25, 0.5), at[5][2] + 4.0))
    bodies.append(box(at[7] + [0, 0, 1.0], np.array([10.0, 0.2, 1.5]), around[7] + np.pi / 2))
    return bodies, at[6] + np.array([0.0, 0.0, 0.9]), 1.2


def beams(case: Case, rng: np.random.Generator) -> tuple[F64, F64, F64]:
    """Origins, unit directions as measured and as they truly are, (n, 3) each."""
    low, high, turn = SCANNERS[case.rings]
    count = {"standing": 1, "rolling": 3, "flying": 3}[case.motion]
    speed, height = {"standing": (0, 1.6), "rolling": (1.5, 1.0), "flying": (5.0, 9.0)}[case.motion]
    share = np.arange(count * turn) / turn
    t = np.repeat(SWEEP_S * share, case.rings)
    azimuth = np.repeat(2 * np.pi * share, case.rings)
    ring = np.tile(np.radians(np.linspace(low, high, case.rings)), count * turn)
    heading = rng.uniform(0, 2 * np.pi) + rng.uniform(-0.5, 0.5) * (case.motion != "standing") * t
    out = []
    for elevation in (ring, ring + np.radians(case.jitter_deg) * rng.normal(size=len(ring))):
        x, y, z = (
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        )
        if case.motion == "flying":  # the axis lies along the flight
            x, y, z = z, y, x
        roll = 0.03 * (case.motion != "standing")
        y, z = y * np.cos(roll) - z * np.sin(roll), y * np.sin(roll) + z * np.cos(roll)
        cos, sin = np.cos(heading), np.sin(heading)
        out.append(np.column_stack([x * cos - y * sin, x * sin + y * cos, z]))
    heading_0 = np.array([np.cos(heading[0]), np.sin(heading[0]), 0.0])
    gone = t + PAUSE_S * np.repeat(np.arange(count), turn * case.rings)
    way = speed * (gone - gone.mean())[:, None] * heading_0
    return way + np.array([0.0, 0.0, height]), out[0], out[1]


def scan(case: Case, seed: int) -> Scan:
    """The points of a case."""
    rng = np.random.default_rng([seed, case.rings, round(1e4 * case.noise_m)])
    bodies, middle, radius = scene(rng)
    origin, told, true = beams(case, rng)
    length = np.min([body.meet(origin, true) for body in bodies], axis=0)
    enter, leave = through(origin, true, middle, radius)
    leaf = enter + rng.exponential(LEAVES_M, len(enter))
    bush = (leaf < leave) & (leaf < length)
    length = np.where(bush, leaf, length)
    seen = (length > NEAREST_M) & (length < LONGEST_M)
    origin, told, length, bush = origin[seen], told[seen], length[seen], bush[seen]
    length = length + case.noise_m * rng.normal(size=len(length))
    r = origin + length[:, None] * told
    label = np.where(bush, BUSH, SURFACE)
    stray = np.flatnonzero(rng.uniform(size=len(r)) < case.stray)
    along, anywhere = stray[::2], stray[1::2]
    r[along] = (
        origin[along] + (length[along] * rng.uniform(0.1, 1.3, len(along)))[:, None] * told[along]
    )
    near = np.quantile(r, [0.02, 0.98], axis=0)
    r[anywhere] = rng.uniform(near[0], near[1] + [0, 0, 2.0], (len(anywhere), 3))
    label[stray] = STRAY
    r = np.round(r / case.step_m) * case.step_m
    order = rng.permutation(np.repeat(np.arange(len(r)), case.copies))
    r, label = r[order], label[order]
    distance = to_surface(bodies, r)
    clear = np.minimum(distance, np.linalg.norm(r - middle, axis=1) - radius)
    return Scan(r, label, distance, (label == STRAY) & (clear > FAR_M), bodies)


def to_surface(bodies: list[Body], r: F64) -> F64:
    """Distance (n,) m of points (n, 3) from the nearest body."""
    return np.asarray(np.min([body.distance(r) for body in bodies], axis=0))

"""Further troubles of a survey: what stands, grows or hangs beside a pile and over it, ground that
is no plane, flights that go wrong. Drawn at random within the ranges that each states.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.simulation.platforms import Platform, lanes
from ladar_volume.simulation.scenes import Ground, box_mesh
from ladar_volume.simulation.troubled_scenes import (
    AROUND_M,
    BEYOND_M,
    DURATION_S,
    F64,
    Pile,
    SceneDraft,
    rectangle,
)

Mesh = tuple[F64, npt.NDArray[np.int32]]


def leaves(rng: np.random.Generator, centre: F64, radii: F64, count: int, size: float) -> Mesh:
    """Triangles of a size (m) with any orientation, evenly within an ellipsoid: what grows, and
    what hangs in the air. Rays pass between them.
    """
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    middle = centre + direction * rng.random((count, 1)) ** (1 / 3) * radii
    corners = middle[:, None] + rng.normal(0.0, size / 2.0, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def surface(d: SceneDraft, x: float, y: float) -> float:
    """Height of pile or ground at a place, m."""
    at = np.array([x]), np.array([y])
    return float(d.ground(*at)[0] + d.pile.height(*at)[0])


def grow(d: SceneDraft, x: float, y: float, radii: F64, lift: float, size: float) -> None:
    """A plant at a place, its middle so far above the surface."""
    count = int(1.2 * math.pi * radii[0] * radii[1] / (0.4 * size**2))
    centre = np.array([x, y, surface(d, x, y) + lift])
    d.bodies.append(leaves(d.rng, centre, radii, max(count, 8), size))


def box_on(d: SceneDraft, x: float, y: float, size: tuple[float, float, float]) -> Mesh:
    """A box (length, width, height) that stands on the surface."""
    z = surface(d, x, y)
    return box_mesh(*rectangle(x, y, size[0], size[1]), z - 1.0, z + size[2])


def shrubs(d: SceneDraft) -> None:
    """20 to 60 shrubs of 0.15 to 0.8 m on pile and ground."""
    d.names = ("vegetation", "object", "base_toe", "wall")
    for _ in range(d.rng.integers(20, 60)):
        _, x, y = d.on_foot(math.sqrt(d.rng.uniform(0.3, 2.5)))
        high = d.rng.uniform(0.15, 0.8)
        grow(d, x, y, np.array([high, high, 0.5 * high]), 0.5 * high, 0.1)


def low_shrubs(d: SceneDraft) -> None:
    """Growth of 0.1 to 0.2 m on 20 to 40 % of the ground."""
    d.names = ("vegetation", "object", "base_toe", "base_bends", "base_uneven", "budget")
    high, own, ground = d.rng.uniform(0.1, 0.2), d.pile, d.ground
    patches = Ground(0.0, (0.0, 0.0), 1.0, 0.6, int(d.rng.integers(1 << 30)))
    least = d.rng.uniform(0.25, 0.85)

    def overgrown(u: F64, v: F64) -> F64:
        off = np.hypot(u / own.a, v / own.b) > 1.0
        return ground(u, v) + np.where(off & (patches(u, v) > least), high, 0.0)

    d.ground = overgrown


def trees(d: SceneDraft) -> None:
    """One to four trees with crowns of 1 to 2.5 m around the toe."""
    d.names = ("object", "wall", "further_bodies")
    for _ in range(d.rng.integers(1, 5)):
        _, x, y = d.on_foot(d.rng.uniform(0.9, 1.4))
        r, high = d.rng.uniform(1.0, 2.5), d.rng.uniform(2.5, 5.0)
        d.bodies.append(box_on(d, x, y, (0.25, 0.25, high)))
        grow(d, x, y, np.array([r, r, 0.8 * r]), high, 0.2)


def cable(d: SceneDraft) -> None:
    """A cable of 4 cm hangs 1.5 to 4 m over the crest."""
    d.names = ("object", "wall")
    y, z = d.rng.uniform(-2.0, 2.0), d.pile.height_m + d.rng.uniform(1.5, 4.0)
    far = d.pile.a + AROUND_M + BEYOND_M
    d.bodies.append(box_mesh(-far, far, y - 0.02, y + 0.02, z, z + 0.04))


def people(d: SceneDraft) -> None:
    """Two to five people stand on the pile and beside it."""
    d.names = ("object", "wall", "further_bodies")
    for _ in range(d.rng.integers(2, 6)):
        _, x, y = d.on_foot(d.rng.uniform(0.5, 1.3))
        d.bodies.append(box_on(d, x, y, (0.5, 0.4, d.rng.uniform(1.6, 1.9))))


def dust(d: SceneDraft) -> None:
    """A cloud of dust hangs over a flank."""
    d.names = ("object", "wall", "budget")
    _, x, y = d.on_foot(0.6)
    radii = np.array([d.rng.uniform(2.0, 4.0), d.rng.uniform(2.0, 4.0), 1.5])
    centre = np.array([x, y, surface(d, x, y) + 2.0])
    d.bodies.append(leaves(d.rng, centre, radii, int(d.rng.integers(200, 1500)), 0.05))


def dozer(d: SceneDraft) -> None:
    """A machine of 4 to 5 m stands on the pile."""
    d.names = ("object", "wall")
    _, x, y = d.on_foot(d.rng.uniform(0.0, 0.7))
    size = d.rng.uniform(4.0, 5.0), d.rng.uniform(2.0, 2.8), d.rng.uniform(2.2, 3.2)
    d.bodies.append(box_on(d, x, y, size))


def machine_leaves(d: SceneDraft) -> None:
    """A machine stands at the toe in the first half of the flight and is gone in the second."""
    d.names = ("object", "wall", "budget")
    _, x, y = d.on_foot(d.rng.uniform(0.95, 1.1))
    d.leaving.append(box_on(d, x, y, (3.0, 2.0, d.rng.uniform(2.0, 3.0))))
    d.flight_trouble = dataclasses.replace(
        d.flight_trouble, later_s=d.rng.uniform(0.35, 0.65) * DURATION_S
    )


def heaped(d: SceneDraft) -> None:
    """The pile grows by 5 to 30 % half-way through the flight; true is its volume at the end."""
    d.names = ("changed",)
    steep = d.pile.steep * d.rng.uniform(1.05, 1.3)
    d.later_pile = Pile(d.pile.a, d.pile.b, d.pile.top, steep)
    d.volume_m3 = d.later_pile.volume_m3
    d.flight_trouble = dataclasses.replace(
        d.flight_trouble, later_s=d.rng.uniform(0.35, 0.65) * DURATION_S
    )


def slab(d: SceneDraft) -> None:
    """The pile stands on a slab of 10 to 40 cm that reaches 1 to 3 m beyond its toe."""
    d.names = ("base_toe",)
    high, wide = d.rng.uniform(0.1, 0.4), d.rng.uniform(1.0, 3.0)
    own, ground = d.pile, d.ground
    d.ground = lambda u, v: (
        ground(u, v)
        + high * np.clip((1.0 + wide / own.b - np.hypot(u / own.a, v / own.b)) * own.b / 0.05, 0, 1)
    )


def fence(d: SceneDraft) -> None:
    """A fence of 1.2 to 2 m runs 0.5 to 3 m beside the toe."""
    d.names = ("object", "wall", "further_bodies")
    at, far = d.pile.a + d.rng.uniform(0.5, 3.0), d.pile.b + AROUND_M
    d.bodies.append(box_mesh(at, at + 0.06, -far, far, -0.5, d.rng.uniform(1.2, 2.0)))


def conveyor(d: SceneDraft) -> None:
    """A belt hangs 0.5 to 1.5 m above the crest and leads away."""
    d.names = ("object", "wall", "unseen")
    z, far = d.pile.height_m + d.rng.uniform(0.5, 1.5), d.pile.a + AROUND_M
    d.bodies.append(box_mesh(d.rng.uniform(-1.0, 1.0), far, -0.6, 0.6, z, z + 0.5))


def shed(d: SceneDraft) -> None:
    """A shed of 3 to 5 m stands 1 to 3 m beside the toe."""
    d.names = ("object", "wall", "further_bodies")
    size = d.rng.uniform(3.0, 5.0)
    x = d.pile.a + d.rng.uniform(1.0, 3.0) + 0.5 * size
    d.bodies.append(box_on(d, x, d.rng.uniform(-3.0, 3.0), (size, size, d.rng.uniform(2.5, 4.0))))


def bank(d: SceneDraft) -> None:
    """Beyond the toe the ground rises 1 to 4 m at 25 to 45 degrees."""
    d.names = ("base_toe", "base_bends", "cut", "wall", "further_bodies", "ground_one_sided")
    at, high = d.pile.a * d.rng.uniform(0.95, 1.3), d.rng.uniform(1.0, 4.0)
    steep, ground = math.tan(math.radians(d.rng.uniform(25.0, 45.0))), d.ground
    d.ground = lambda u, v: ground(u, v) + np.clip((u - at) * steep, 0.0, high)


def pit_beside(d: SceneDraft) -> None:
    """A pit of 3 to 6 m, 0.5 to 1.5 m deep, lies 1 to 2 m beside the toe."""
    d.names = ("base_toe", "base_bends", "below_base")
    r, deep, ground = d.rng.uniform(3.0, 6.0), d.rng.uniform(0.5, 1.5), d.ground
    at = d.pile.a + d.rng.uniform(1.0, 2.0) + r
    d.ground = lambda u, v: ground(u, v) - np.clip(r - np.hypot(u - at, v), 0.0, deep)


def ditch(d: SceneDraft) -> None:
    """A ditch of 1 to 2 m, 0.2 to 0.5 m deep, runs around the toe."""
    d.names = ("base_toe", "base_bends", "below_base")
    wide, deep, own, ground = d.rng.uniform(1.0, 2.0), d.rng.uniform(0.2, 0.5), d.pile, d.ground

    def dug(u: F64, v: F64) -> F64:
        beyond = (np.hypot(u / own.a, v / own.b) - 1.0) * own.b
        return ground(u, v) - deep * np.clip(1.0 - np.abs(2.0 * beyond / wide - 1.0), 0.0, None)

    d.ground = dug


def ruts(d: SceneDraft) -> None:
    """Ruts of 5 to 15 cm, 2 m apart, run over the ground and under the pile."""
    deep, ground = d.rng.uniform(0.05, 0.15), d.ground
    d.ground = lambda u, v: ground(u, v) - deep * np.clip(2.0 * np.sin(math.pi * u) - 1.0, 0, 1)
    d.names = ("base_toe", "base_bends", "vegetation", "budget")


def steep_ground(d: SceneDraft) -> None:
    """The ground falls by 8 to 14 degrees."""
    fall, phi = math.tan(math.radians(d.rng.uniform(8.0, 14.0))), d.rng.uniform(0, 2 * math.pi)
    ground = d.ground
    d.ground = lambda u, v: ground(u, v) + fall * (u * math.cos(phi) + v * math.sin(phi))


def varied_ground(d: SceneDraft) -> None:
    """Nothing is wrong: ground of 1 to 10 cm over 0.5 to 10 m, a third to three times the usual
    number of returns.
    """
    rough, long = 0.01 * 10.0 ** d.rng.uniform(0.0, 1.0), 0.5 * 20.0 ** d.rng.uniform(0.0, 1.0)
    d.ground = Ground(0.0, (0.0, 0.0), rough, long / 3.0, int(d.rng.integers(1 << 30)))
    d.flight_trouble = dataclasses.replace(
        d.flight_trouble, thin=round(10.0 * 3.0 ** d.rng.uniform(-1.0, 1.0))
    )


def puddles(d: SceneDraft) -> None:
    """Water stands in 3 to 8 puddles of 2 to 5 m, some at the toe: no returns."""
    d.names = ("unseen", "ground_one_sided")
    for _ in range(d.rng.integers(3, 9)):
        _, x, y = d.on_foot(d.rng.uniform(1.0, 1.7))
        d.holes.append(rectangle(x, y, d.rng.uniform(2.0, 5.0), d.rng.uniform(2.0, 5.0)))


def thin_toe(d: SceneDraft) -> None:
    """The pile runs out in a toe that thins with the square of the distance; nothing is set."""
    d.names = ("base_toe", "base_bends", "thin_toe", "cut")
    d.pile = ThinPile(d.pile.a, d.pile.b, 0.0, d.pile.steep)
    d.volume_m3 = d.pile.volume_m3
    d.volume = {"object_height_m": 0.15, "outline_margin_m": 1.0, "ground_ring_m": 10.0}


class ThinPile(Pile):
    """A pile whose height is that of a cone squared."""

    @property
    def volume_m3(self) -> float:
        """Exact volume above the ground, m³."""
        return math.pi * self.a * self.b * self.height_m / 6.0

    def height(self, x: F64, y: F64) -> F64:
        """Height above the ground at x, y, m."""
        r = np.hypot(x / self.a, y / self.b)
        out: F64 = self.height_m * np.clip(1.0 - r, 0.0, 1.0) ** 2
        return out


def flat_top_shadow(d: SceneDraft) -> None:
    """One pass beside a pile with a flat top: what lies behind its edge is in shadow."""
    d.names = ("unseen", "ground_one_sided", "cut")
    d.pile = Pile(d.pile.a, d.pile.b, d.rng.uniform(0.4, 0.6), d.pile.steep)
    d.volume_m3 = d.pile.volume_m3
    far, high = d.pile.b + d.rng.uniform(0.0, 8.0), d.pile.height_m + d.rng.uniform(3.0, 8.0)
    d.flight = one_pass(2.0 * d.pile.a + AROUND_M, far, high)


def one_pass(long: float, offset_m: float, high: float) -> Platform:
    """A straight pass of a length (m) so far beside the middle, and so high."""
    along = lanes(long, high, DURATION_S)

    def position(t: F64) -> F64:
        s = np.clip(t / DURATION_S, -0.1, 1.1) - 0.5
        return np.column_stack([s * long, np.full(len(t), -offset_m), high + 0.2 * np.sin(0.9 * t)])

    def angles(t: F64) -> F64:
        sway = np.radians(1.0) * np.sin(2.3 * t)
        return np.column_stack([sway, np.radians(2.0) + 0.5 * sway, np.zeros(len(t))])

    return dataclasses.replace(along, name="pass", position=position, angles=angles)


def large_footprints(d: SceneDraft) -> None:
    """Footprints of 10 to 18 cm where the budget says 4 cm, and a third of the returns."""
    d.names = ("budget", "unseen", "vegetation")
    d.true_budget = dataclasses.replace(
        d.true_budget, beam_divergence_rad=d.rng.uniform(0.004, 0.007)
    )
    d.flight_trouble = dataclasses.replace(d.flight_trouble, thin=30)


def gnss_jump(d: SceneDraft) -> None:
    """Fixes are off by 8 to 25 cm from a moment of the flight on."""
    d.names = ("budget", "passes_shifted")
    e, n, u = d.rng.normal(0.0, 1.0, 3)
    size = d.rng.uniform(0.08, 0.25) / math.sqrt(e * e + n * n + u * u)
    d.flight_trouble = dataclasses.replace(
        d.flight_trouble,
        jump_s=d.rng.uniform(0.25, 0.75) * DURATION_S,
        jump_m=(e * size, n * size, u * size),
    )


def wrong_clock(d: SceneDraft) -> None:
    """The clocks are 20 to 60 ms apart."""
    d.names = ("budget",)
    d.true_budget = dataclasses.replace(d.true_budget, clock_sigma_s=d.rng.uniform(0.02, 0.06))


def lever_above_level(d: SceneDraft) -> None:
    """The antenna sits 10 to 25 cm lower or higher than stated, and the volume is above a level."""
    d.names = ("base_level", "cut", "budget")
    d.ground = Ground(0.0, (0.0, 0.0), 0.01, 1.0, int(d.rng.integers(1 << 30)))
    d.volume = {"base": "level", "level_m": 0.0}
    off = float(d.rng.choice([-1.0, 1.0])) * d.rng.uniform(0.10, 0.25)
    d.flight_trouble = dataclasses.replace(d.flight_trouble, jump_s=-10.0, jump_m=(0.0, 0.0, off))


def float_spans(d: SceneDraft) -> None:
    """The receiver has a float fix for a third of the flight, and says so."""
    first = d.rng.uniform(0.1, 0.6) * DURATION_S
    d.flight_trouble = dataclasses.replace(
        d.flight_trouble, floats_s=((first, first + DURATION_S / 3.0),)
    )


def rain(d: SceneDraft) -> None:
    """Half to four fifths of the returns are lost."""
    d.names = ("unseen",)
    d.flight_trouble = dataclasses.replace(d.flight_trouble, dropout_share=d.rng.uniform(0.5, 0.8))


def echoes(d: SceneDraft) -> None:
    """1 to 6 % of the returns take a longer way and seem to come from below the ground."""
    d.names = ("edges", "object", "budget")
    d.flight_trouble = dataclasses.replace(d.flight_trouble, echo_share=d.rng.uniform(0.01, 0.06))


FURTHER: tuple[Callable[[SceneDraft], Any], ...] = (
    shrubs,
    low_shrubs,
    trees,
    cable,
    people,
    dust,
    dozer,
    machine_leaves,
    heaped,
    slab,
    fence,
    conveyor,
    shed,
    bank,
    pit_beside,
    ditch,
    ruts,
    steep_ground,
    varied_ground,
    puddles,
    thin_toe,
    flat_top_shadow,
    large_footprints,
    gnss_jump,
    wrong_clock,
    lever_above_level,
    float_spans,
    rain,
    echoes,
)

"""Scenes in which something is not as the model has it: holes, cuts, walls, pads, plants, machines,
wrong budgets. Drawn at random within stated ranges; the volume of the pile is exact.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.simulation.platforms import Platform, lanes
from ladar_volume.simulation.scenes import (
    REPOSE,
    Ground,
    Scene,
    box_mesh,
    join,
    polar_mesh,
)
from ladar_volume.simulation.suited_parameters import SUITED

F64 = npt.NDArray[np.float64]
Settings = dict[str, dict[str, Any]]
#: Ground around the foot of the pile, m, and of what the scene has beyond the region.
AROUND_M, BEYOND_M = 9.0, 6.0
DURATION_S = 36.0


@dataclass(frozen=True)
class FlightTrouble:
    """What happens on a flight. thin : every so many firing cycles are kept · dropout_share : of
    the returns · floats_s : spans of a float fix · jump_s, jump_m : from when on fixes are off by
    how much · later_s, later : from when on the scene is another · echo_share : of the returns,
    that come from behind what was hit
    """

    thin: int = 10
    dropout_share: float = 0.01
    floats_s: tuple[tuple[float, float], ...] = ()
    jump_s: float = math.inf
    jump_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    later_s: float = math.inf
    later: Scene | None = None
    echo_share: float = 0.0


@dataclass(frozen=True)
class Trouble:
    """A survey with one trouble. settings : sections and keys that a surveyor would choose ·
    true_budget :
    the budget that errors are drawn from, the believed one being the default · names : the doubts
    that name the cause · flight_trouble : what happened on the flight
    """

    kind: str
    scene: Scene
    platform: Platform
    settings: Settings
    names: tuple[str, ...]
    true_budget: BudgetParameters = field(default_factory=BudgetParameters)
    flight_trouble: FlightTrouble = field(default_factory=lambda: FlightTrouble())


@dataclass(frozen=True)
class Pile:
    """An elliptic frustum: semi-axes of the foot a, b, m · top : size of the flat top over the foot
    · steep : tangent of its slope along b.
    """

    a: float
    b: float
    top: float
    steep: float

    @property
    def height_m(self) -> float:
        """Height of the top above the ground, m."""
        return self.b * self.steep * (1.0 - self.top)

    @property
    def volume_m3(self) -> float:
        """Exact volume above the ground, m³."""
        return math.pi * self.a * self.b * self.height_m * (1 + self.top + self.top**2) / 3.0

    def height(self, x: F64, y: F64) -> F64:
        """Height above the ground at x, y, m."""
        r = np.hypot(x / self.a, y / self.b)
        out: F64 = self.height_m * np.clip((1.0 - r) / (1.0 - self.top), 0.0, 1.0)
        return out


def drawn_pile(rng: np.random.Generator) -> Pile:
    """A pile of 150 to 1,500 m³."""
    a = rng.uniform(7.0, 12.0)
    top = float(rng.choice([0.0, rng.uniform(0.1, 0.5)]))
    return Pile(a, a * rng.uniform(0.75, 1.0), top, math.tan(REPOSE) * rng.uniform(0.75, 1.0))


def drawn_ground(rng: np.random.Generator) -> Ground:
    """Sloping ground, rough by 1 cm over 1 m."""
    slope = (rng.normal(0.0, 0.01), rng.normal(0.0, 0.01))
    return Ground(0.0, slope, 0.010, 1.0, int(rng.integers(1 << 30)))


def pile_mesh(pile: Pile, ground: Callable[[F64, F64], F64]) -> tuple[F64, npt.NDArray[np.int32]]:
    """The pile with the ground around it."""
    reach = (max(pile.a, pile.b) + AROUND_M + BEYOND_M) / pile.b
    inner = np.linspace(0, 1, 41)[1:]
    rho = np.unique(np.concatenate([inner, [pile.top] if pile.top > 0 else [], [1.0]]))
    outer = 1.0 + np.geomspace(0.02, reach - 1.0, 60)

    def profile(r: F64) -> F64:
        return pile.height(r * pile.a, np.zeros_like(r))

    return polar_mesh(np.concatenate([rho, outer]), pile.a, pile.b, profile, ground)


def remove_rectangle(mesh: tuple[F64, npt.NDArray[np.int32]], box: tuple[float, ...]) -> Any:
    """The mesh without what lies in a rectangle x0, x1, y0, y1: rays return nothing there."""
    vertices, triangles = mesh
    x, y = vertices[triangles, :2].mean(axis=1).T
    hit = (x > box[0]) & (x < box[1]) & (y > box[2]) & (y < box[3])
    return vertices, triangles[~hit]


class SceneDraft:
    """One random pile on its ground, to which a kind of trouble adds its own."""

    def __init__(self, seed: int, kind: str) -> None:
        self.rng = np.random.default_rng([seed, sum(map(ord, kind))])
        self.kind, self.pile = kind, drawn_pile(self.rng)
        self.ground: Callable[[F64, F64], F64] = drawn_ground(self.rng)
        self.volume_m3 = self.pile.volume_m3
        half = max(self.pile.a, self.pile.b) + AROUND_M
        self.region = [-half, -half, -10.0, half, half, 30.0]
        self.true_budget = BudgetParameters()
        self.volume: dict[str, Any] = {}
        self.holes: list[tuple[float, ...]] = []
        self.bodies: list[Any] = []
        self.names: tuple[str, ...] = ()
        self.flight_trouble = FlightTrouble()
        self.flight: Platform | None = None
        self.leaving: list[Any] = []
        self.later_pile: Pile | None = None

    def on_foot(self, share: float) -> tuple[float, float, float]:
        """A direction, and the place in it at a share of the foot's radius."""
        phi = self.rng.uniform(0, 2 * math.pi)
        x, y = share * self.pile.a * math.cos(phi), share * self.pile.b * math.sin(phi)
        return phi, x, y

    def trouble(self) -> Trouble:
        """The scene as drawn."""
        mesh = self._ground_mesh(self.pile)
        extent = max(self.pile.a, self.pile.b) + AROUND_M
        scene = self._scene(join(mesh, *self.bodies, *self.leaving), extent)
        if self.leaving:
            later = self._scene(join(mesh, *self.bodies), extent)
            self.flight_trouble = dataclasses.replace(self.flight_trouble, later=later)
        if self.later_pile is not None:
            later = self._scene(join(self._ground_mesh(self.later_pile), *self.bodies), extent)
            self.flight_trouble = dataclasses.replace(self.flight_trouble, later=later)
        flight = self.flight or lanes(0.5 * extent, 25.0, DURATION_S)
        settings: Settings = {
            "filter": dict(SUITED["pile"]["filter"]),
            "volume": {**SUITED["pile"]["volume"], **self.volume},
            "georeference": {"region_m": [float(round(v, 3)) for v in self.region]},
        }
        return Trouble(
            self.kind, scene, flight, settings, self.names, self.true_budget, self.flight_trouble
        )

    def _ground_mesh(self, pile: Pile) -> tuple[F64, npt.NDArray[np.int32]]:
        mesh = pile_mesh(pile, self.ground)
        for hole in self.holes:
            mesh = remove_rectangle(mesh, hole)
        return mesh

    def _scene(self, mesh: tuple[F64, npt.NDArray[np.int32]], extent: float) -> Scene:
        return Scene(self.kind, *mesh, self.volume_m3, np.zeros((0, 2)), extent + BEYOND_M)


def rectangle(x: float, y: float, long: float, wide: float) -> tuple[float, float, float, float]:
    """A rectangle about a place."""
    return (x - long / 2, x + long / 2, y - wide / 2, y + wide / 2)


def clean(d: SceneDraft) -> None:
    """Nothing is wrong."""


def crest_hole(d: SceneDraft) -> None:
    """No returns on 2 to 6 m of the crest."""
    d.names = ("unseen",)
    size = d.rng.uniform(2.0, 6.0)
    _, x, y = d.on_foot(d.rng.uniform(0.0, 0.25))
    d.holes.append(rectangle(x, y, size, size))


def top_hole(d: SceneDraft) -> None:
    """No returns on much of the top."""
    d.names = ("unseen",)
    d.holes.append(
        rectangle(0.0, 0.0, d.pile.a * d.rng.uniform(0.5, 0.8), d.pile.b * d.rng.uniform(0.4, 0.6))
    )


def flank_hole(d: SceneDraft) -> None:
    """No returns on 2 to 5 m of a flank."""
    d.names = ("unseen",)
    size = d.rng.uniform(2.0, 5.0)
    _, x, y = d.on_foot(0.55)
    d.holes.append(rectangle(x, y, size, size))


def toe_hole(d: SceneDraft) -> None:
    """No returns on 4 to 7 m across the toe."""
    d.names = ("unseen",)
    size = d.rng.uniform(4.0, 7.0)
    _, x, y = d.on_foot(1.0)
    d.holes.append(rectangle(x, y, size, size))


def open_hole(d: SceneDraft) -> None:
    """No returns on a strip from a flank to the edge of the survey."""
    d.names = ("unseen", "ground_one_sided", "cut")
    wide = d.rng.uniform(3.0, 8.0)
    far = d.pile.a + AROUND_M + BEYOND_M
    d.holes.append((d.pile.a * d.rng.uniform(0.5, 0.9), far, -wide / 2, wide / 2))


def region_cut(d: SceneDraft) -> None:
    """The region ends on the pile."""
    d.names = ("cut",)
    d.region[3] = d.pile.a * d.rng.uniform(0.1, 0.8)


def region_toe(d: SceneDraft) -> None:
    """The region ends just at the toe."""
    d.names = ("cut", "ground_one_sided")
    d.region[3] = d.pile.a * d.rng.uniform(0.85, 0.98)


def one_side(d: SceneDraft) -> None:
    """The survey ends on the crest: the other side was not flown."""
    d.names = ("cut", "unseen", "ground_one_sided")
    far = d.pile.a + AROUND_M + BEYOND_M
    d.holes.append((d.rng.uniform(-0.1, 0.3) * d.pile.a, far, -far, far))


def two_piles(d: SceneDraft) -> None:
    """A second pile beside the first, and `bodies: 1`."""
    d.names = ("further_bodies",)
    _, x, y = d.on_foot(1.0)
    far = math.hypot(x, y)
    r = d.rng.uniform(3.0, 6.0)
    x, y = x * (far + r + 2.0) / far, y * (far + r + 2.0) / far
    own, ground = d.pile, d.ground
    second = Pile(r, r, 0.0, own.steep)
    d.ground = lambda u, v: ground(u, v) + second.height(u - x, v - y)
    d.region = [
        min(d.region[0], x - r - 4.0),
        min(d.region[1], y - r - 4.0),
        -10.0,
        max(d.region[3], x + r + 4.0),
        max(d.region[4], y + r + 4.0),
        30.0,
    ]


def wall(d: SceneDraft) -> None:
    """The pile lies against a wall: what is behind it is not there."""
    d.names = ("wall", "cut", "further_bodies")
    at = d.pile.a * d.rng.uniform(0.5, 0.9)
    half, high = d.pile.b + AROUND_M, d.rng.uniform(2.5, 4.0)
    d.bodies.append(box_mesh(at, at + 0.4, -half, half, -0.5, high))
    u = np.linspace(-1.0, 1.0, 4001)
    x, y = np.meshgrid(0.5 * (u[:-1] + u[1:]) * d.pile.a, 0.5 * (u[:-1] + u[1:]) * d.pile.b)
    cell = (u[1] - u[0]) ** 2 * d.pile.a * d.pile.b
    d.volume_m3 = float(d.pile.height(x, y)[x < at].sum() * cell)
    own, ground = d.pile, d.ground
    # behind the wall the ground is flat: the pile's part there is taken off the surface
    d.ground = lambda u, v: ground(u, v) - np.where(u > at + 0.2, own.height(u, v), 0.0)


def pad(d: SceneDraft) -> None:
    """The pile stands in a pit stripped 0.2 to 0.5 m deep, 1 to 3 m wider than it."""
    d.names = ("base_toe", "cut")
    deep, wide = d.rng.uniform(0.2, 0.5), d.rng.uniform(1.0, 3.0)
    own, ground = d.pile, d.ground
    d.ground = lambda u, v: (
        ground(u, v)
        - deep * np.clip((1.0 + wide / own.b - np.hypot(u / own.a, v / own.b)) * own.b / 0.3, 0, 1)
    )


def hollow(d: SceneDraft) -> None:
    """The ground is a bowl."""
    d.names = ("base_bends", "base_toe")
    bend, ground = d.rng.uniform(0.0005, 0.0015), d.ground
    d.ground = lambda u, v: ground(u, v) + bend * (u * u + v * v)


def undulating(d: SceneDraft) -> None:
    """The ground undulates by 3 to 6 cm over 4 to 8 m."""
    d.names = ("base_bends", "base_toe")
    d.ground = Ground(
        0.0,
        (0.0, 0.0),
        d.rng.uniform(0.03, 0.06),
        d.rng.uniform(4.0, 8.0) / 3.0,
        int(d.rng.integers(1 << 30)),
    )


def machine(d: SceneDraft) -> None:
    """A machine stands at the toe."""
    d.names = ("wall", "further_bodies")
    _, x, y = d.on_foot(1.05)
    x0, x1, y0, y1 = rectangle(x, y, 3.0, 2.0)
    d.bodies.append(box_mesh(x0, x1, y0, y1, -0.5, d.rng.uniform(2.0, 3.0)))


def grass(d: SceneDraft) -> None:
    """Grass of 5 to 10 cm everywhere but under the pile."""
    overgrow(d, d.rng.uniform(0.05, 0.10), on_pile=False)


def grass_on_pile(d: SceneDraft) -> None:
    """Grass of 5 to 15 cm on the pile alone."""
    overgrow(d, d.rng.uniform(0.05, 0.15), on_pile=True)


def overgrow(d: SceneDraft, high: float, on_pile: bool) -> None:
    """Grass, m high, on the pile or everywhere but under it."""
    d.names = ("vegetation",)
    own, ground = d.pile, d.ground
    tufts = Ground(0.0, (0.0, 0.0), 0.02, 0.05, int(d.rng.integers(1 << 30)))
    d.ground = lambda u, v: (
        ground(u, v)
        + np.where((np.hypot(u / own.a, v / own.b) > 1.0) ^ on_pile, high + tufts(u, v), 0.0)
    )


def wrong_attitude(d: SceneDraft) -> None:
    """The attitude is five times worse than believed."""
    d.names = ("budget",)
    sigma = tuple(5.0 * s for s in d.true_budget.attitude_sigma_rad)
    d.true_budget = dataclasses.replace(d.true_budget, attitude_sigma_rad=sigma)


def wrong_beams(d: SceneDraft) -> None:
    """The beams are five times worse than believed."""
    d.names = ("budget",)
    d.true_budget = dataclasses.replace(
        d.true_budget,
        beam_range_sigma_m=5.0 * d.true_budget.beam_range_sigma_m,
        beam_vertical_sigma_rad=5.0 * d.true_budget.beam_vertical_sigma_rad,
    )


def wrong_position(d: SceneDraft) -> None:
    """The position is five times worse than believed, and wanders within 10 s."""
    d.names = ("budget",)
    sigma = tuple(5.0 * s for s in d.true_budget.position_sigma_m)
    d.true_budget = dataclasses.replace(d.true_budget, position_sigma_m=sigma, tau_position_s=10.0)


def wrong_boresight(d: SceneDraft) -> None:
    """The boresight is off by half a degree."""
    d.names = ("budget",)
    d.true_budget = dataclasses.replace(d.true_budget, boresight_sigma_rad=(math.radians(0.5),) * 3)

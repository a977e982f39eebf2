"""Piles of unusual shape, on unusual ground, beside and below things, as point clouds above their
own ground, through the command line with nothing set. The kinds are others than those of
:mod:`benchmarks.troubled_clouds`.

An answer is *silent* where it is more than three standard deviations off with a sound verdict. In
the kinds of :data:`HARMLESS` nothing is wrong: a doubt is a false alarm.

``python -m benchmarks.odd_piles [KIND ...] [--seeds N] [--first SEED]``
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ladar_volume.cli.main import main as ladar_volume

F64 = npt.NDArray[np.float64]
Heights = Callable[[F64], F64]
DENSITY, WAVES, CELLS = 15.0, 200, 1500


def cone(q: F64, at: tuple[float, float], a: float, b: float, high: float, top: float = 0.0) -> F64:
    """Heights (n,) m of an elliptic cone or frustum."""
    reach = np.hypot((q[:, 0] - at[0]) / a, (q[:, 1] - at[1]) / b)
    return np.asarray(high * np.clip((1.0 - reach) / (1.0 - top), 0.0, 1.0))


def block(q: F64, at: tuple[float, float], half: tuple[float, float], high: float) -> F64:
    """Heights (n,) m of an upright block."""
    return np.where((np.abs(q - at) < half).all(axis=1), high, 0.0)


class Site:
    """Undulating, sloping ground and the size of an ordinary pile of 50 to 600 m³."""

    def __init__(self, seed: int, kind: str) -> None:
        self.rng = rng = np.random.default_rng([seed, *map(ord, kind)])
        self.slope, self.noise = rng.normal(0.0, 0.015, 2), rng.uniform(0.006, 0.02)
        self.waves = rng.normal(0.0, 0.5, (WAVES, 2)), rng.uniform(0.0, 2.0 * math.pi, WAVES)
        self.a = rng.uniform(6.0, 9.0)
        self.b = self.a * rng.uniform(0.7, 1.0)
        self.high = self.b * math.tan(math.radians(rng.uniform(25.0, 36.0)))
        self.half = (self.a + rng.uniform(6.0, 10.0), self.b + rng.uniform(6.0, 10.0))

    def pile(self, q: F64) -> F64:
        """An ordinary one."""
        return cone(q, (0.0, 0.0), self.a, self.b, self.high)

    def ground(self, q: F64) -> F64:
        """A slope, and undulations of 1 cm."""
        swell = np.sin(q @ self.waves[0].T + self.waves[1]).sum(axis=1)
        return np.asarray(q @ self.slope + 0.01 * math.sqrt(2.0 / WAVES) * swell)

    def places(self, density: float = DENSITY) -> F64:
        """Random ones (n, 2) on the site."""
        count = self.rng.poisson(4.0 * density * self.half[0] * self.half[1])
        return self.rng.uniform(-1.0, 1.0, (count, 2)) * self.half

    def seen(self, q: F64, height: F64) -> F64:
        """Points (n, 3) at places, with noise."""
        return np.c_[q, height + self.rng.normal(0.0, self.noise, len(q))]

    def volume(self, pile: Heights) -> float:
        """Of heights above the ground, m³."""
        x, y = ((np.arange(CELLS) + 0.5) / CELLS * 2.0 * h - h for h in self.half)
        rows = [pile(np.c_[x, np.full(CELLS, at)]).mean() for at in y]
        return float(np.mean(rows)) * 4.0 * self.half[0] * self.half[1]


#: The cloud, and the heights whose volume is true.
Drawn = tuple[F64, Heights]


def shaped(
    s: Site, pile: Heights, ground: Heights | None = None, density: float = DENSITY
) -> Drawn:
    """A pile on the ground."""
    q = s.places(density)
    return s.seen(q, (ground or s.ground)(q) + pile(q)), pile


def windrow(s: Site) -> Drawn:
    """A long ridge."""
    wide, long = s.rng.uniform(3.0, 5.0), s.rng.uniform(15.0, 25.0)
    s.half = (long + 8.0, wide + 8.0)

    def ridge(q: F64) -> F64:
        past = np.maximum(np.abs(q[:, 0]) - long + wide, 0.0)
        return np.asarray(0.6 * wide * np.clip(1.0 - np.hypot(past, q[:, 1]) / wide, 0.0, 1.0))

    return shaped(s, ridge)


def ring(s: Site) -> Drawn:
    """A ridge around ground."""
    radius, wide = s.rng.uniform(7.0, 9.0), s.rng.uniform(2.5, 3.5)
    s.half = (20.0, 20.0)
    return shaped(
        s,
        lambda q: 0.6 * wide * np.clip(1.0 - np.abs(np.hypot(*q.T) - radius) / wide, 0.0, 1.0),
    )


def merged(s: Site) -> Drawn:
    """Two piles that touch."""
    apart = 1.6 * s.a
    s.half = (0.5 * apart + s.a + 7.0, s.half[1])

    def both(q: F64) -> F64:
        one = cone(q, (-0.5 * apart, 0.0), s.a, s.b, s.high)
        return np.maximum(one, cone(q, (0.5 * apart, 0.0), 0.9 * s.a, 0.9 * s.b, 0.9 * s.high))

    return shaped(s, both)


def benches(s: Site) -> Drawn:
    """Three steps of 1.2 m at 45°."""

    def steps(q: F64) -> F64:
        r = np.hypot(*q.T)
        return np.asarray(
            sum(1.2 * np.clip((share * s.a - r) / 1.2, 0.0, 1.0) for share in (1.0, 0.7, 0.4))
        )

    return shaped(s, steps)


def dome(s: Site) -> Drawn:
    """Half an ellipsoid, steep at its foot."""
    return shaped(s, lambda q: 2.5 * np.sqrt(np.clip(1.0 - (np.hypot(*q.T) / s.b) ** 2, 0.0, None)))


def bell(s: Site) -> Drawn:
    """A Gaussian without a toe."""
    wide = s.rng.uniform(3.0, 4.5)
    s.half = (5.0 * wide, 5.0 * wide)
    return shaped(s, lambda q: 2.5 * np.exp(-0.5 * (np.hypot(*q.T) / wide) ** 2))


def rubble(s: Site) -> Drawn:
    """Boulders of up to 0.6 m on the flanks are of the pile."""
    at = s.rng.uniform(-s.a, s.a, (120, 2))
    at = at[np.hypot(at[:, 0] / s.a, at[:, 1] / s.b) < 0.95]
    size, floor = s.rng.uniform(0.2, 0.6, len(at)), s.pile(at)

    def rough(q: F64) -> F64:
        z = s.pile(q)
        for place, r, low in zip(at, size, floor, strict=True):
            bulge = np.sqrt(np.clip(r**2 - ((q - place) ** 2).sum(axis=1), 0.0, None))
            z = np.where(bulge > 0.0, np.maximum(z, low + bulge), z)
        return z

    return shaped(s, rough, density=60.0)


def litres(s: Site) -> Drawn:
    """A heap on a table, 2 mm of noise."""
    a, s.noise = s.rng.uniform(0.25, 0.6), 0.002
    s.half = (1.5 * a + 0.3, 1.5 * a + 0.3)
    heap: Heights = lambda q: cone(q, (0.0, 0.0), a, 0.8 * a, 0.5 * a)  # noqa: E731
    return shaped(s, heap, lambda q: q @ s.slope, 8000.0)


def mountain(s: Site) -> Drawn:
    """A million m³, a point and a half to the m²."""
    a, s.noise = s.rng.uniform(80.0, 150.0), 0.05
    s.half = (1.5 * a, 1.5 * a)
    heap: Heights = lambda q: cone(q, (0.0, 0.0), a, 0.8 * a, 0.4 * a, 0.2)  # noqa: E731
    return shaped(s, heap, lambda q: q @ s.slope, 0.7)


def raster(s: Site) -> Drawn:
    """A grid of 0.5 m, heights rounded to 1 cm."""
    x, y = (np.arange(-h, h, 0.5) for h in s.half)
    q = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    p = s.seen(q, s.ground(q) + s.pile(q))
    return np.c_[q, np.round(p[:, 2], 2)], s.pile


def gradient(s: Site) -> Drawn:
    """Twenty times as dense on one side."""
    q = s.places(100.0)
    q = q[s.rng.random(len(q)) < 0.05 + 0.95 * (0.5 + 0.5 * q[:, 0] / s.half[0]) ** 2]
    return s.seen(q, s.ground(q) + s.pile(q)), s.pile


def dark(s: Site) -> Drawn:
    """5 cm of noise on the pile alone."""
    p, pile = shaped(s, s.pile)
    own = pile(p[:, :2]) > 0.3
    p[own, 2] += s.rng.normal(0.0, 0.05, int(own.sum()))
    return p, pile


def stations(s: Site) -> Drawn:
    """Three scanners on tripods, with their shadows."""
    return np.vstack([station(s, at) for at in ((-1.0, -0.8), (1.0, -0.6), (0.1, 1.0))]), s.pile


def one_station(s: Site) -> Drawn:
    """One scanner: the far side was not seen."""
    return station(s, (-1.0, -1.0)), s.pile


def station(s: Site, at: tuple[float, float], count: int = 90_000) -> F64:
    """What a scanner 1.8 m above a place, in shares of the site, sees."""
    eye = np.array(at) * (np.array(s.half) - 1.0)
    turn = s.rng.uniform(0.0, 2.0 * math.pi, count)
    away = 1.5 + 2.8 * max(s.half) * s.rng.random(count) ** 2
    q = eye + away[:, None] * np.c_[np.cos(turn), np.sin(turn)]
    q = q[(np.abs(q) < s.half).all(axis=1)]
    z, high = s.ground(q) + s.pile(q), float(s.ground(eye[None])[0]) + 1.8
    free = np.ones(len(q), bool)
    for t in np.linspace(0.05, 0.97, 60):
        m = eye + t * (q - eye)
        free &= s.ground(m) + s.pile(m) < high + t * (z - high) + 0.02
    return s.seen(q[free], z[free])


def bunker(s: Site) -> Drawn:
    """A heap between three walls of 3 m, as high as it at the back."""
    s.half = (16.0, 16.0)

    def heap(q: F64) -> F64:
        fall = 2.5 * np.clip(1.6 - 1.6 * np.hypot((q[:, 0] + 5.0) / 8.0, q[:, 1] / 8.0), 0.0, 1.0)
        return np.where((q[:, 0] > -5.0) & (np.abs(q[:, 1]) < 5.0), fall, 0.0)

    q = s.places(40.0)
    walls = [block(q, (-5.15, 0.0), (0.15, 5.3), 3.0)]
    walls += [block(q, (-0.65, side * 5.15), (4.65, 0.15), 3.0) for side in (-1.0, 1.0)]
    return s.seen(q, s.ground(q) + np.max([heap(q), *walls], axis=0)), heap


def camber(s: Site) -> Drawn:
    """A road falls by 2.5 % to both sides."""
    return shaped(s, s.pile, lambda q: s.ground(q) - 0.025 * np.abs(q[:, 1]))


def bench(s: Site) -> Drawn:
    """The ground steps up by 0.5 to 1.2 m beside the pile."""
    at, up = s.a + s.rng.uniform(0.5, 2.0), s.rng.uniform(0.5, 1.2)
    return shaped(s, s.pile, lambda q: s.ground(q) + np.clip(q[:, 0] - at, 0.0, up))


def under_step(s: Site) -> Drawn:
    """The ground steps up by 0.3 to 0.8 m under the pile."""
    at, up = s.rng.uniform(-0.5, 0.5) * s.a, s.rng.uniform(0.3, 0.8)
    return shaped(s, s.pile, lambda q: s.ground(q) + np.clip(q[:, 0] - at, 0.0, up))


def berm(s: Site) -> Drawn:
    """A berm of 0.45 m around half of the pile."""
    at = s.a + s.rng.uniform(1.5, 3.0)

    def ground(q: F64) -> F64:
        up = 0.45 * np.clip(1.0 - np.abs(np.hypot(*q.T) - at) / 0.9, 0.0, 1.0)
        return s.ground(q) + np.where(q[:, 0] > 0.0, up, 0.0)

    return shaped(s, s.pile, ground)


def saddle(s: Site) -> Drawn:
    """The ground bends up one way and down the other."""
    bend = s.rng.uniform(0.001, 0.003)
    return shaped(s, s.pile, lambda q: s.ground(q) + bend * (q[:, 0] ** 2 - q[:, 1] ** 2))


def pit(s: Site) -> Drawn:
    """A pit of 1.2 m beside the pile."""
    s.half = (s.a + 9.0, s.half[1])
    return shaped(s, s.pile, lambda q: s.ground(q) - cone(q, (s.a + 4.0, 0.0), 2.5, 2.5, 1.2))


def pond(s: Site) -> Drawn:
    """No returns from water at the foot."""
    p, pile = shaped(s, s.pile)
    wet = np.hypot(*(p[:, :2] - (s.a + 2.5, 0.0)).T) < s.rng.uniform(3.0, 5.0)
    return p[~(wet & (pile(p[:, :2]) <= 0.0))], pile


def mirror(s: Site) -> Drawn:
    """Half of the returns from a puddle come from below it."""
    p, pile = shaped(s, s.pile)
    wet = (np.hypot(*(p[:, :2] - (s.a + 2.0, 0.0)).T) < 2.5) & (pile(p[:, :2]) <= 0.0)
    wet &= s.rng.random(len(p)) < 0.5
    p[wet, 2] -= s.rng.uniform(0.5, 3.0, int(wet.sum()))
    return p, pile


def fence(s: Site) -> Drawn:
    """A fence of 2 m, 0.5 to 2 m from the foot."""
    p, pile = shaped(s, s.pile)
    q = np.c_[np.full(1200, s.a + s.rng.uniform(0.5, 2.0)), s.rng.uniform(-1.0, 1.0, 1200)]
    q *= (1.0, s.half[1])
    q[:, 0] += s.rng.normal(0.0, 0.02, 1200)
    return np.vstack([p, np.c_[q, s.ground(q) + s.rng.uniform(0.0, 2.0, 1200)]]), pile


def wires(s: Site) -> Drawn:
    """Three wires over the pile."""
    p, pile = shaped(s, s.pile)
    q = np.c_[s.rng.uniform(-1.0, 1.0, 800) * s.half[0], s.rng.choice([-1.0, 0.0, 1.0], 800)]
    return np.vstack([p, np.c_[q, s.high + 6.0 + 0.01 * q[:, 0] ** 2]]), pile


def cars(s: Site) -> Drawn:
    """Two cars 2 m from the foot."""
    s.half = (s.a + 9.0, s.half[1])
    places = ((s.a + 3.0, 2.0), (s.a + 3.0, -4.0))
    return shaped(
        s, s.pile, lambda q: s.ground(q) + sum(block(q, at, (0.9, 2.2), 1.5) for at in places)
    )


def container(s: Site) -> Drawn:
    """A container stands half in the pile."""
    q = s.places()
    box = block(q, (s.a - 1.0, 0.0), (1.2, 3.0), 2.6)
    return s.seen(q, s.ground(q) + np.maximum(s.pile(q), box)), s.pile


def house(s: Site) -> Drawn:
    """A house, larger than the pile, is the main body."""
    s.half = (s.a + 20.0, s.half[1])
    return shaped(s, s.pile, lambda q: s.ground(q) + block(q, (s.a + 9.0, 0.0), (5.0, 6.0), 6.0))


def tilted(s: Site) -> Drawn:
    """Two strips that tilt by 4 mrad against one another and lie 1 cm apart."""
    p, pile = shaped(s, s.pile)
    own = p[:, 0] + s.rng.normal(0.0, 3.0, len(p)) > 0.0
    p[own, 2] += 0.004 * p[own, 1] + 0.01
    return p, pile


KINDS: dict[str, Callable[[Site], Drawn]] = {
    f.__name__.replace("_", " "): f
    for f in (
        *(windrow, ring, merged, benches, dome, bell, rubble, litres, mountain),
        *(raster, gradient, dark, stations, one_station),
        *(camber, bench, under_step, berm, saddle, pit, pond, mirror),
        *(bunker, fence, wires, cars, container, house, tilted),
    )
}
#: Kinds in which nothing is wrong that a volume would have to be doubted for.
HARMLESS = (
    *("windrow", "ring", "merged", "benches", "dome", "rubble", "litres", "mountain"),
    *("raster", "gradient", "dark", "stations", "cars", "pit"),
)


def answer(kind: str, seed: int) -> tuple[str, bool, bool]:
    """What the command line says, in a line; whether it is silent; whether a false alarm."""
    site = Site(seed, kind)
    points, pile = KINDS[kind](site)
    true, said, why = site.volume(pile), io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "cloud.npy")
        np.save(path, points)
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(why):
            code = ladar_volume(["volume", path, "--base", "ground", "--json"])
    head = f"{kind:12s} {seed} {true:11.2f} m³"
    if code:
        return f"{head} refused: {why.getvalue().strip()[:120]}", False, kind in HARMLESS
    found = json.loads(said.getvalue())
    net, sigma, verdict = found["net_m3"], found["sigma_m3"], found["verdict"]
    z, sound = (net - true) / sigma, verdict["status"] == "sound"
    names = ", ".join(reason["name"] for reason in verdict["reasons"])
    words = f"{100 * (net / true - 1.0):+8.2f} ± {100 * sigma / true:6.2f} %, z {z:+7.2f}"
    silent, alarm = abs(z) > 3.0 and sound, not sound and kind in HARMLESS
    mark = " SILENT" if silent else " false alarm" if alarm else ""
    return f"{head} {words} {verdict['status']} {names}{mark}", silent, alarm


def main() -> int:
    """Print a line for each cloud; 1 where an answer was silent."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", nargs="*", choices=[*KINDS, []], default=[])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1)
    a = parser.parse_args()
    silent = alarms = harmless = count = 0
    for kind in a.kind or KINDS:
        for seed in range(a.first, a.first + a.seeds):
            line, is_silent, is_alarm = answer(kind, seed)
            print(line, flush=True)
            count, silent, alarms = count + 1, silent + is_silent, alarms + is_alarm
            harmless += kind in HARMLESS
    print(f"silent: {silent} of {count}; false alarms: {alarms} of {harmless}")
    return 1 if silent else 0


if __name__ == "__main__":
    raise SystemExit(main())

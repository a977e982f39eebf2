"""Piles as point clouds in which something is not as the model has it: holes, cuts, walls, pads,
plants, machines, strays, scan lines, copies. Above its own ground, or (``pair: ...``) above a
second cloud of the ground, through the command line with nothing set.

An answer is *silent* where it is more than three standard deviations off with a sound verdict:
there must be none. A clean cloud that is doubted is a false alarm.

``python -m benchmarks.troubled_clouds [KIND ...] [--seeds N] [--first SEED] [--piles BASE]``; with
``--piles`` within an outline drawn 0.5 to 1.5 m outside the foot, above that base.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ladar_volume.cli.main import main as ladar_volume

F64 = npt.NDArray[np.float64]
SEEDS, NOISE_M, WAVES = 6, 0.012, 200
#: Kinds in which nothing is wrong that a volume would have to be doubted for.
HARMLESS = (
    "clean",
    "steep ground",
    "far away",
    "scan lines",
    "copies",
    "strays above",
    "heavy tails",
    "pair: clean",
    "pair: strays",
)


class Site:
    """A random elliptic pile of 80 to 1,000 m³ on its ground, sampled at random from above.

    xy : (n, 2) m · volume_m3 : exact, above the ground
    """

    def __init__(self, seed: int, kind: str, density: float) -> None:
        self.rng = rng = np.random.default_rng([seed, *map(ord, kind)])
        self.a = rng.uniform(6.0, 11.0)
        self.b = self.a * rng.uniform(0.7, 1.0)
        self.top = float(rng.choice([0.0, rng.uniform(0.1, 0.5)]))
        self.height = self.b * math.tan(math.radians(rng.uniform(24.0, 36.0))) * (1.0 - self.top)
        share = (1.0 + self.top + self.top**2) / 3.0
        self.volume_m3 = math.pi * self.a * self.b * self.height * share
        self.half = self.a + rng.uniform(6.0, 10.0)
        self.slope = rng.normal(0.0, 0.015, 2)
        self.waves = rng.normal(0.0, 0.5, (WAVES, 2)), rng.uniform(0.0, 2.0 * np.pi, WAVES)
        count = rng.poisson(density * (2.0 * self.half) ** 2)
        self.xy = rng.uniform(-self.half, self.half, (count, 2))

    def ground(self, xy: F64) -> F64:
        """A slope, and undulations of 1 cm over some metres."""
        k, phase = self.waves
        swell = np.zeros(len(xy))
        for wave, at in zip(k, phase, strict=True):
            swell += np.sin(xy @ wave + at)
        return np.asarray(xy @ self.slope + 0.01 * math.sqrt(2.0 / WAVES) * swell)

    def reach(self, xy: F64) -> F64:
        """Distance from the middle, 1 at the foot."""
        return np.asarray(np.hypot(xy[:, 0] / self.a, xy[:, 1] / self.b))

    def pile(self, xy: F64) -> F64:
        """Height above the ground."""
        sunk = np.clip((1.0 - self.reach(xy)) / (1.0 - self.top), 0.0, 1.0)
        return np.asarray(self.height * sunk)

    def points(self) -> F64:
        """The clean cloud (n, 3)."""
        z = self.ground(self.xy) + self.pile(self.xy)
        return np.c_[self.xy, z + self.rng.normal(0.0, NOISE_M, len(z))]


def near(p: F64, x: float, y: float, radius: float) -> npt.NDArray[np.bool_]:
    """Points within a circle."""
    return np.asarray(np.hypot(p[:, 0] - x, p[:, 1] - y) < radius)


def hole(share: float) -> Callable[[Site], F64]:
    """No returns in a circle, its middle at a share of the way to the foot."""

    def make(s: Site) -> F64:
        p = s.points()
        return p[~near(p, share * s.a, 0.0, s.rng.uniform(1.0, 3.0))]

    return make


def cut(s: Site) -> F64:
    """The survey ends on the pile."""
    p = s.points()
    return p[p[:, 0] < s.a * s.rng.uniform(0.2, 0.93)]


def second(s: Site) -> F64:
    """A small pile in a corner."""
    p = s.points()
    off = np.hypot(*(p[:, :2] - (s.half - 3.5)).T) / 2.5
    p[:, 2] += 1.4 * np.clip(1.0 - off, 0.0, 1.0)
    return p


def wall(s: Site) -> F64:
    """A terrace that the pile leans against."""
    p = s.points()
    behind = p[:, 0] > s.rng.uniform(0.6, 0.9) * s.a
    p[behind, 2] += 2.5 - s.pile(p[behind, :2])
    return p


def pad(s: Site) -> F64:
    """The soil below and beside the pile was stripped."""
    p = s.points()
    p[s.reach(p[:, :2]) < s.rng.uniform(1.05, 1.2), 2] -= s.rng.uniform(0.2, 0.5)
    return p


def hollow(s: Site) -> F64:
    """The ground is a bowl."""
    p = s.points()
    p[:, 2] += s.rng.uniform(0.0006, 0.002) * (p[:, :2] ** 2).sum(axis=1)
    return p


def grass(side: float) -> Callable[[Site], F64]:
    """Plants of some 5 to 12 cm beyond a line, not on the pile."""

    def make(s: Site) -> F64:
        p = s.points()
        grown = (s.reach(p[:, :2]) > 1.05) & (p[:, 0] > side * s.half)
        p[grown, 2] += s.rng.gamma(2.0, s.rng.uniform(0.025, 0.06), int(grown.sum()))
        return p

    return make


def shrubs(s: Site) -> F64:
    """Forty shrubs of half a metre beside the pile."""
    p = s.points()
    for _ in range(40):
        at = s.rng.uniform(-s.half, s.half, 2)
        own = near(p, *at, s.rng.uniform(0.4, 1.2))
        if s.reach(at[None])[0] > 1.2:
            p[own, 2] += s.rng.uniform(0.0, 0.5, int(own.sum()))
    return p


def trees(s: Site) -> F64:
    """Six crowns that three returns of five stay in, anywhere."""
    p = s.points()
    for _ in range(6):
        own = near(p, *s.rng.uniform(-s.half, s.half, 2), s.rng.uniform(1.0, 2.0))
        own &= s.rng.random(len(p)) < 0.6
        p[own, 2] += s.rng.uniform(1.5, 6.0, int(own.sum()))
    return p


def machine(s: Site) -> F64:
    """An excavator at the foot."""
    p, phi = s.points(), s.rng.uniform(0.0, 2.0 * math.pi)
    at = 0.85 * np.array([s.a * math.cos(phi), s.b * math.sin(phi)])
    own = (np.abs(p[:, :2] - at) < (1.5, 3.0)).all(axis=1)
    p[own, 2] = s.ground(at[None])[0] + s.rng.uniform(2.4, 2.6, int(own.sum()))
    return p


def strips(s: Site) -> F64:
    """Every other point belongs to a flight line 5 cm higher."""
    p = s.points()
    p[s.rng.random(len(p)) < 0.5, 2] += 0.05
    return p


def fault(s: Site) -> F64:
    """A flight line 6 cm higher begins beside the middle."""
    p = s.points()
    p[p[:, 0] > s.rng.uniform(-3.0, 3.0), 2] += 0.06
    return p


def strays(share: float, low: float, high: float) -> Callable[[Site], F64]:
    """A share of the points is off."""

    def make(s: Site) -> F64:
        p = s.points()
        off = s.rng.random(len(p)) < share
        p[off, 2] += s.rng.uniform(low, high, int(off.sum()))
        return p

    return make


def heavy(s: Site) -> F64:
    """Noise with tails."""
    p = s.points()
    p[:, 2] += 0.01 * s.rng.standard_t(2, len(p))
    return p


def thin_top(s: Site) -> F64:
    """Three returns of a hundred on the upper part."""
    p = s.points()
    return p[~((s.reach(p[:, :2]) < 0.6) & (s.rng.random(len(p)) < 0.97))]


def lines(s: Site) -> F64:
    """Scan lines a metre apart."""
    s.xy[:, 0] = np.round(s.xy[:, 0])
    return s.points()


def machine_on_lines(s: Site) -> F64:
    """An excavator at the foot, seen along scan lines a metre apart."""
    s.xy[:, 0] = np.round(s.xy[:, 0])
    return machine(s)


def steep_ground(s: Site) -> F64:
    """A hillside."""
    s.slope = np.add(s.slope, (0.25, 0.0))
    return s.points()


def blurred(s: Site) -> F64:
    """Footprints of 30 cm."""
    at = s.xy + s.rng.normal(0.0, 0.15, s.xy.shape)
    return np.c_[s.xy, s.ground(at) + s.pile(at) + s.rng.normal(0.0, NOISE_M, len(at))]


def apron(s: Site) -> F64:
    """A thin toe, 12 cm at the foot and none at 1.4 times its distance, is part of the pile."""

    def more(xy: F64) -> F64:
        r = s.reach(xy)
        rise = np.clip((r - 0.9) / 0.1, 0.0, 1.0)
        return np.asarray(0.3 * np.clip(1.4 - r, 0.0, 0.4) * rise)

    p = s.points()
    p[:, 2] += more(p[:, :2])
    side = np.linspace(-1.5 * s.a, 1.5 * s.a, 1201)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    s.volume_m3 += float(more(grid).sum()) * (side[1] - side[0]) ** 2
    return p


def far_away(s: Site) -> F64:
    """Coordinates of a national grid."""
    return np.add(s.points(), (433_000.0, 5_100_000.0, 212.0))


def decimetres(s: Site) -> F64:
    """Coordinates rounded to 10 cm."""
    return np.round(s.points(), 1)


def copies(s: Site) -> F64:
    """Every point three times."""
    return np.tile(s.points(), (3, 1))


def over_empty(upper: Callable[[Site], F64]) -> Callable[[Site], list[F64]]:
    """The cloud above one of the ground alone."""
    return lambda s: [upper(s), lower(s)]


def lower(s: Site) -> F64:
    """The ground before the pile was there."""
    xy = s.rng.uniform(-s.half, s.half, s.xy.shape)
    return np.c_[xy, s.ground(xy) + s.rng.normal(0.0, NOISE_M, len(xy))]


def over_higher(s: Site) -> list[F64]:
    """The survey of the ground lies 4 cm higher."""
    return [s.points(), np.add(lower(s), (0.0, 0.0, 0.04))]


def over_part(s: Site) -> list[F64]:
    """The survey of the ground ends below the pile."""
    b = lower(s)
    return [s.points(), b[b[:, 0] < s.a * s.rng.uniform(-0.3, 0.8)]]


def over_holed(s: Site) -> list[F64]:
    """The survey of the ground has a hole below the pile."""
    b = lower(s)
    return [s.points(), b[~near(b, 2.0, 0.0, s.rng.uniform(1.5, 3.5))]]


def drawn(s: Site, kind: str) -> F64:
    """An outline (48, 2) outside the foot."""
    a = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    out = s.rng.uniform(0.5, 1.5) + (0.4 * s.a if kind == "apron" else 0.0)
    ring = np.column_stack([(s.a + out) * np.cos(a), (s.b + out) * np.sin(a)])
    return ring + ((433_000.0, 5_100_000.0) if kind == "far away" else (0.0, 0.0))


PAIRS: dict[str, Callable[[Site], list[F64]]] = {
    "pair: clean": over_empty(Site.points),
    "pair: higher": over_higher,
    "pair: part": over_part,
    "pair: holed": over_holed,
    "pair: crest hole": over_empty(hole(0.0)),
    "pair: cut": over_empty(cut),
    "pair: grass": over_empty(grass(-1.0)),
    "pair: trees": over_empty(trees),
    "pair: machine": over_empty(machine),
    "pair: strays": over_empty(strays(0.02, 0.3, 10.0)),
}
KINDS: dict[str, Callable[[Site], F64]] = {
    "clean": Site.points,
    "crest hole": hole(0.0),
    "flank hole": hole(0.5),
    "toe hole": hole(1.0),
    "cut": cut,
    "second pile": second,
    "wall": wall,
    "pad": pad,
    "hollow": hollow,
    "grass": grass(-1.0),
    "grass on one side": grass(0.0),
    "shrubs": shrubs,
    "trees": trees,
    "machine": machine,
    "strips": strips,
    "fault": fault,
    "strays above": strays(0.02, 0.3, 10.0),
    "strays below": strays(0.01, -8.0, -0.5),
    "heavy tails": heavy,
    "thin top": thin_top,
    "scan lines": lines,
    "machine on lines": machine_on_lines,
    "steep ground": steep_ground,
    "blurred": blurred,
    "apron": apron,
    "far away": far_away,
    "decimetres": decimetres,
    "copies": copies,
}


@dataclass(frozen=True)
class Answer:
    """error, sigma : shares of the true volume, NaN where it was refused · status, reasons : of the
    verdict
    """

    error: float
    sigma: float
    status: str
    reasons: tuple[str, ...]

    @property
    def far(self) -> bool:
        """Off by more than three standard deviations."""
        return abs(self.error) > 3.0 * self.sigma

    @property
    def silent(self) -> bool:
        """Far, without a word."""
        return self.far and self.status == "sound"


def answer(kind: str, seed: int, density: float = 15.0, piles: str = "") -> Answer:
    """What the command line says of a cloud; of its pile above the base ``piles``, where given."""
    site = Site(seed, kind, density)
    clouds = PAIRS[kind](site) if kind in PAIRS else [KINDS[kind](site)]
    said, why = io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        paths = [str(Path(folder) / f"cloud_{k}.npy") for k in range(len(clouds))]
        for path, points in zip(paths, clouds, strict=True):
            np.save(path, points)
        base = [] if kind in PAIRS else ["--base", piles or "ground"]
        if piles:
            corners = ", ".join(f"{x!r} {y!r}" for x, y in drawn(site, kind).tolist())
            first = corners.split(", ")[0]
            file = Path(folder) / "outline.wkt"
            file.write_text(f"POLYGON(({corners}, {first}))", encoding="utf-8")
            base += ["--piles", str(file)]
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(why):
            code = ladar_volume(["volume", *paths, *base, "--json"])
    if code:
        return Answer(math.nan, math.nan, "refused", (why.getvalue().strip(),))
    found = json.loads(said.getvalue())
    reasons = tuple(r["name"] for r in found["verdict"]["reasons"])
    true = site.volume_m3
    error, sigma = found["net_m3"] / true - 1.0, found["sigma_m3"] / true
    return Answer(error, sigma, found["verdict"]["status"], reasons)


def main() -> int:
    """Print a line per kind; 1 where an answer was silent."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", nargs="*", choices=[*KINDS, *PAIRS, []], default=[])
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--piles", default="", metavar="BASE")
    a = parser.parse_args()
    print(
        f"{'kind':18s} {'error RMS':>9s} {'sigma':>7s} {'far':>4s} silent doubtful refused reasons"
    )
    silent, harmless = 0, [0, 0]
    for kind in a.kind or [*KINDS, *PAIRS]:
        found = [answer(kind, seed, piles=a.piles) for seed in range(a.first, a.first + a.seeds)]
        told = [f for f in found if f.status != "refused"]
        rms = math.sqrt(np.mean([f.error**2 for f in told])) if told else math.nan
        sigma = float(np.median([f.sigma for f in told])) if told else math.nan
        count = [sum(f.far for f in told), sum(f.silent for f in told)]
        doubtful = sum(f.status == "doubtful" for f in told)
        reasons = sorted({r for f in told for r in f.reasons})
        silent += count[1]
        if kind in HARMLESS:
            harmless = [harmless[0] + doubtful, harmless[1] + len(found)]
        print(
            f"{kind:18s} {100 * rms:8.2f}% {100 * sigma:6.2f}% {count[0]:4d} {count[1]:6d} "
            f"{doubtful:8d} {len(found) - len(told):7d} {', '.join(reasons)}",
            flush=True,
        )
    print(f"silent: {silent}; of {harmless[1]} harmless clouds {harmless[0]} are doubted")
    return 1 if silent else 0


if __name__ == "__main__":
    raise SystemExit(main())

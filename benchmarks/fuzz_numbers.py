"""Random command lines over random clouds, each once more with the cloud moved, turned, scaled, in
other units, in another order, with every point twice, in another format, or on two threads: the
result must be the same.

Clouds: piles, pits and roofs on level and sloped ground; points at random, in rows, rounded, dense
on one side, some twice, with strays; from 10 cm to a kilometre, near the origin and at coordinates
of a national grid. Verbs: ``volume`` above a level, a plane and the ground, and between two clouds,
``body``, ``tin`` and ``diff``, with random options.

``python -m benchmarks.fuzz_numbers [--count N] [--seed S]``; exit code 1 where a result differs by
more than its kind of change explains.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import random
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from ladar_volume.cli.main import DEFECT
from ladar_volume.cli.main import main as verb

Points = npt.NDArray[np.float64]
#: How far a volume may move, in its sigmas, and by what factor sigma may change: where the change
#: keeps every number, and where it gives the points other places in the order of the work.
EXACT, SAME, NEAR = (1e-6, 1.0 + 1e-6), (0.05, 1.02), (1.0, 1.3)
#: How much of a number that has no sigma (areas, counts) may differ.
SHARE = 0.02


@dataclass(frozen=True)
class Option:
    """words : of the command line · lengths : that many of its last values are lengths · height :
    the last is a height
    """

    words: tuple[str, ...]
    values: tuple[float, ...] = ()
    kind: str = "length"

    def moved(self, change: Change) -> list[str]:
        """As the command line has it after the change."""
        v = [change.scale * x for x in self.values]
        if self.kind == "height":
            v = [x + change.shift[2] for x in v]
        if self.kind == "point":
            v = list(change.of(np.array([self.values]))[0])
        return [*self.words, *(f"{x:.17g}" for x in v)]


@dataclass(frozen=True)
class Change:
    """p -> scale * R(turn) p + shift, in another order, file format or unit, by so many threads."""

    name: str
    within: tuple[float, float]
    scale: float = 1.0
    turn_deg: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    order: bool = False
    twice: bool = False
    suffix: str = ".npy"
    unit: tuple[str, float] | None = None
    threads: int = 1

    def of(self, p: Points) -> Points:
        """The changed points (n, 3)."""
        c, s = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
        if self.turn_deg % 90.0 == 0.0:
            c, s = float(round(c)), float(round(s))
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(self.scale * (p @ R.T) + np.array(self.shift))


@dataclass(frozen=True)
class Survey:
    """name : of the verb · clouds : one or two, m · options"""

    name: str
    clouds: tuple[Points, ...]
    options: tuple[Option, ...]


SAID = Change("as it is", EXACT)


def changes(draw: random.Random, size: float) -> list[Change]:
    """All kinds of change once, ``size`` : of the cloud, m."""
    far = tuple(float(round(draw.uniform(-1e4, 1e4) * size)) for _ in range(2))
    return [
        Change("order", SAME, order=True),
        Change("moved", SAME, shift=(*far, float(round(draw.uniform(-3, 3) * size)))),
        Change("moved to a national grid", SAME, shift=(458_000.0, 5_550_000.0, 210.0)),
        Change("turned by 90 degrees", SAME, turn_deg=90.0),
        Change("turned", NEAR, turn_deg=draw.uniform(5.0, 85.0)),
        Change("twice as large", SAME, scale=2.0),
        Change("a tenth", SAME, scale=0.1),
        Change("in millimetres", SAME, unit=("mm", 0.001)),
        Change("in feet", SAME, unit=("ft", 0.3048)),
        Change("another format", EXACT, suffix=".xyz"),
        Change("two threads", EXACT, threads=2),
        Change("every point twice", NEAR, twice=True),
    ]


def ground(draw: random.Random, rng: np.random.Generator, n: int, size: float) -> Points:
    """Places (n, 2) within ``size``: at random, in rows, or dense on one side."""
    kind = draw.randrange(4)
    if kind == 0:
        return rng.uniform(-size, size, (n, 2))
    if kind == 1:
        side = round(math.sqrt(n))
        a = np.linspace(-size, size, side)
        x, y = np.meshgrid(a, a)
        return np.column_stack([x.ravel(), y.ravel()]) + rng.normal(0, 1e-3 * size, (side**2, 2))
    if kind == 2:
        rows = rng.integers(0, 30, n) * (2.0 * size / 30.0) - size
        return np.column_stack([rng.uniform(-size, size, n), rows])
    return np.column_stack(
        [size * (2.0 * rng.beta(1.3, 2.2, n) - 1.0), rng.uniform(-size, size, n)]
    )


def shape(kind: str, xy: Points, size: float, height: float) -> Points:
    """Heights (n,) of what stands on the ground."""
    d = np.hypot(xy[:, 0] - 0.1 * size, xy[:, 1] + 0.05 * size) / (0.6 * size)
    if kind == "cone":
        return height * np.maximum(0.0, 1.0 - d)
    if kind == "pit":
        return -height * np.maximum(0.0, 1.0 - d**2)
    if kind == "roof":
        inside = (np.abs(xy) < 0.5 * size).all(axis=1)
        return np.where(inside, height * (0.3 + 0.7 * (1.0 - np.abs(xy[:, 0]) / (0.5 * size))), 0.0)
    return height * np.exp(-3.0 * d**2)


def cloud(draw: random.Random, kind: str, size: float) -> Points:
    """A cloud with its noise, slope and troubles."""
    rng = np.random.default_rng(draw.randrange(2**32))
    xy = ground(draw, rng, draw.randrange(500, 2200), size)
    z = shape(kind, xy, size, 0.3 * size)
    z += draw.choice((0.0, 0.0, 0.05, 0.15)) * xy[:, 0] + draw.choice((0.0, 0.1)) * xy[:, 1]
    z += rng.normal(0.0, draw.choice((0.0, 1e-4, 1e-3, 5e-3)) * size, len(z))
    p = np.column_stack([xy, z])
    if draw.random() < 0.25:
        p = np.round(p / (2.0**-9 * size)) * (2.0**-9 * size)
    if draw.random() < 0.25:
        p = np.vstack([p, p[rng.integers(0, len(p), len(p) // 10)]])
    if draw.random() < 0.25:
        stray = rng.integers(0, len(p), max(len(p) // 200, 1))
        p[stray, 2] += rng.uniform(0.2, 1.0, len(stray)) * size
    return np.asarray(p)


def survey(draw: random.Random) -> tuple[Survey, float]:
    """A random command, and the size of its cloud, m."""
    size = 10.0 ** draw.uniform(-0.5, 2.7)
    kind = draw.choice(("cone", "pit", "roof", "hill"))
    clouds = (cloud(draw, kind, size),)
    name = draw.choice(("volume",) * 6 + ("body", "tin", "diff"))
    options: list[Option] = []
    if name == "volume":
        options, pair = surface_options(draw, size), draw.random()
        if pair < 0.3:
            clouds = (*clouds, cloud(draw, "hill", size))
        elif pair < 0.65:
            options.append(Option(("--level",), (draw.uniform(-0.05, 0.2) * size,), "height"))
        else:
            options.append(Option(("--base", "ground")))
    if name == "tin":
        options = surface_options(draw, size)
    if name == "diff":
        clouds = (*clouds, cloud(draw, "pit", size))
        options = [Option(("--pole",), (0.0, 0.0, 0.8 * size), "point")]
    return Survey(name, clouds, tuple(options)), size


def surface_options(draw: random.Random, size: float) -> list[Option]:
    """Options of a surface, often none."""
    known = [
        Option(("--sigma",), (draw.choice((1e-3, 0.01)) * size,)),
        Option(("--vertices", draw.choice(("0.3", "0.7", "150")))),
        Option(("--max-edge",), (draw.uniform(0.3, 1.0) * size,)),
        Option(("--clean", draw.choice(("off", "auto", "filter")))),
        Option(("--relevant", draw.choice(("all", "sampled", "edge", "corners")))),
        Option(("--adjust", draw.choice(("rms", "asd", "none")))),
        Option(("--exchange", draw.choice(("asd", "rms")))),
        Option(("--criterion", draw.choice(("residual", "residual-area")))),
    ]
    return draw.sample(known, draw.choice((0, 0, 1, 1, 2, 3)))


def words_of(one: Survey, change: Change, folder: Path, seed: int) -> list[str]:
    """The command line; its files are written."""
    files = []
    for at, points in enumerate(one.clouds):
        p = change.of(points)
        rng = np.random.default_rng(seed + at)
        p = np.vstack([p, p]) if change.twice else p
        p = p[rng.permutation(len(p))] if change.order else p
        p = p / change.unit[1] if change.unit else p
        file = folder / f"{'ab'[at]}{change.suffix}"
        if change.suffix == ".npy":
            np.save(file, p)
        else:
            file.write_text("".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in p.tolist()))
        files.append(str(file))
    words = [one.name, *files]
    for option in one.options:
        moved = option.moved(change)
        words += [moved[0], ",".join(moved[1:])] if option.kind == "point" else moved
    words += ["--units", change.unit[0] if change.unit else "m"]
    return (
        [*words, "-o", str(folder / "out.ply"), "--json"]
        if one.name in ("body", "tin")
        else [
            *words,
            "--json",
        ]
    )


def carried_out(words: list[str], threads: int = 1) -> tuple[int, dict[str, Any], str]:
    """Exit code, the result, standard error."""
    out, err = io.StringIO(), io.StringIO()
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = verb(words)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
    text = out.getvalue()
    return code, json.loads(text) if code in (0, 3) and text else {}, err.getvalue()


def numbers(name: str, facts: dict[str, Any]) -> tuple[dict[str, float], float]:
    """What is compared, by name with the power of the length in it, and the sigma of the
    volumes.
    """
    if name == "tin":
        return {"area_m2": facts["area_m2"], "rms_m": facts["rms_m"]}, 0.0
    keys = ("volume_m3",) if name in ("body", "diff") else ("net_m3", "cut_m3", "fill_m3")
    return {k: facts[k] for k in (*keys, "area_m2") if k in facts}, facts["sigma_m3"]


def differs(one: Survey, change: Change, was: Any, now: Any) -> list[str]:
    """What differs by more than the kind of change explains."""
    (code, facts, err), (other_code, other, other_err) = was, now
    if other_code == DEFECT or "Traceback" in other_err:
        return [f"defect: {other_err[-200:]}"]
    if code not in (0, 3) or other_code not in (0, 3):
        return (
            [] if code == other_code else [f"exit {code}, {other_code}: {(err or other_err)[:150]}"]
        )
    said = []
    (a, sigma), (b, sigma_b) = numbers(one.name, facts), numbers(one.name, other)
    far, factor = change.within
    for key in a:
        power = int(key[-1]) if key[-1] in "23" else 1
        before, after = a[key] * change.scale**power, b[key]
        s, whole = sigma * change.scale**3, abs(before) + 1e-12 * change.scale**power
        near = SHARE if change.within == NEAR else 1e-6 if change.within == EXACT else 2e-3
        allowed = max(far * s, 1e-6 * whole) if power == 3 else near * whole
        if not abs(after - before) <= allowed:
            ratio = abs(after - before) / s if power == 3 and s else math.nan
            said.append(f"{key} {before:.6g} -> {after:.6g} ({ratio:.3g} sigma)")
    s, t = sigma * change.scale**3, sigma_b
    if s > 0.0 and not 1.0 / factor <= t / s <= factor:
        said.append(f"sigma {s:.4g} -> {t:.4g}")
    status, changed = (f.get("verdict", {}).get("status") for f in (facts, other))
    if status != changed and change.within != NEAR:
        said.append(f"{status} -> {changed}")
    return said


def fuzz(count: int, seed: int) -> dict[str, Any]:
    """``count`` commands with all changes each: what differed."""
    draw, seen, ends = random.Random(seed), [], Counter[str]()
    trials, slowest = Counter[str](), 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(count):
            one, size = survey(draw)
            was = carried_out(words := words_of(one, SAID, folder, seed))
            ends[f"exit {was[0]}"] += 1
            if was[0] == DEFECT or "Traceback" in was[2]:
                seen.append({"case": number, "change": "-", "words": words, "said": was[2][-300:]})
            for change in changes(draw, size):
                if was[0] not in (0, 3) and change.name not in ("order", "in feet"):
                    continue
                began = time.monotonic()
                words = words_of(one, replace(change), folder, seed)
                now = carried_out(words, change.threads)
                slowest = max(slowest, time.monotonic() - began)
                trials[change.name] += 1
                if said := differs(one, change, was, now):
                    case = {"case": number, "change": change.name, "size_m": round(size, 2)}
                    shown = [w.rpartition("/")[2] for w in words]
                    seen.append(case | {"words": " ".join(shown), "said": said})
                    print(json.dumps(seen[-1]), file=sys.stderr, flush=True)
    by_change = Counter(s["change"] for s in seen)
    return {
        "commands": count,
        "ends": dict(ends.most_common()),
        "changes": {k: f"{by_change[k]} of {n}" for k, n in trials.items()},
        "slowest_s": round(slowest, 1),
        "differ": seen,
    }


def main() -> int:
    """Print what differed as JSON."""
    parser = argparse.ArgumentParser(description="invariances of random commands")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    out = fuzz(arguments.count, arguments.seed)
    print(json.dumps(out, indent=1))
    return int(bool(out["differ"]))


if __name__ == "__main__":
    sys.exit(main())

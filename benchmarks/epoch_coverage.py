"""Do the 95 % intervals of cut, of fill and of net between two surveys hold? Two simulated surveys
of one place go through the filter, the TIN (full or partial) and the comparison, as in ``epochs``.

Change, slope and size are drawn anew in every pair: ground that did not change, ground raised or
lowered as a whole, hollows and rises of a few noises, a pile and a pit. Returns have noise; each
survey as a whole lies wrong by its own error of position (``position_m``), which its budget knows.

``python -m benchmarks epoch_coverage``. A row: mean and standard deviation of the error in sigma,
and share of the intervals that hold.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.change.surface_difference import interpolation
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, MappedPoints, PlatformStates
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.volume.estimator import VolumeEstimator

#: Side of the square ground, noise of one return, and the survey's length.
SIDE, NOISE, SECONDS = 8.0, 0.02, 20
#: Returns per square metre.
DENSITY = 40.0
#: Calibration without error: what the two surveys share is for test/change to show.
EXACT = {
    "beam_range_sigma_m": 0.0,
    "beam_vertical_sigma_deg": 0.0,
    "range_bias_sigma_m": 0.0,
    "boresight_sigma_deg": [0.0, 0.0, 0.0],
    "lever_laser_sigma_m": [0.0, 0.0, 0.0],
    "lever_antenna_sigma_m": [0.0, 0.0, 0.0],
    "clock_sigma_s": 0.0,
    "position_bias_fraction": 1.0,
    "position_white_fraction": 0.0,
}
Change = Callable[[F64, F64], F64]


def unchanged(rng: np.random.Generator) -> Change:
    """Ground as it was."""
    return lambda x, y: 0.0 * x


def shifted(rng: np.random.Generator) -> Change:
    """All of the ground up or down by 2 to 30 mm."""
    by = rng.uniform(0.002, 0.03) * rng.choice([-1.0, 1.0])
    return lambda x, y: by + 0.0 * x


def waves(rng: np.random.Generator) -> Change:
    """Hollows and rises of 5 to 50 mm, 3 to 10 m from one to the next, about a level that moved by
    up to half of that.
    """
    height, length = rng.uniform(0.005, 0.05), rng.uniform(3.0, 10.0)
    mean, phase, turn = (
        height * rng.uniform(-0.5, 0.5),
        rng.uniform(0.0, 6.28, 2),
        rng.uniform(0.0, 6.28),
    )
    k = 2.0 * np.pi / length

    def change(x: F64, y: F64) -> F64:
        u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
        return np.asarray(mean + height * np.sin(k * u + phase[0]) * np.cos(k * v + phase[1]))

    return change


def heap(rng: np.random.Generator) -> Change:
    """A heap or, as often, a pit anywhere, 0.1 to 1 m high, the ground around as it was."""
    x0, y0 = rng.uniform(2.5, SIDE - 2.5, 2)
    height, radius = rng.uniform(0.1, 1.0) * rng.choice([-1.0, 1.0]), rng.uniform(1.5, 2.5)

    def change(x: F64, y: F64) -> F64:
        far = np.minimum(np.hypot(x - x0, y - y0) / radius, 1.0)
        return np.asarray(0.5 * height * (1.0 + np.cos(np.pi * far)))

    return change


def heap_and_pit(rng: np.random.Generator) -> Change:
    """Both, of different size."""
    one, two = heap(rng), heap(rng)
    return lambda x, y: np.abs(one(x, y)) - np.abs(two(x, y))


CHANGES = {
    "unchanged": unchanged,
    "shifted": shifted,
    "waves": waves,
    "heap": heap,
    "heap and pit": heap_and_pit,
}


class Case(NamedTuple):
    """change : name of one of :data:`CHANGES` · slope : most slope of the ground · ratio : of
    vertices to points · position_m : standard deviation of each survey's height as a whole
    """

    change: str
    slope: float
    ratio: float
    position_m: float

    def words(self) -> str:
        """The row's name."""
        ground, kind = (
            "sloping" if self.slope else "level",
            "full" if self.ratio == 1 else "partial",
        )
        lies = f", positions {1e3 * self.position_m:g} mm" if self.position_m else ""
        return f"{self.change}, {ground}, {kind} TIN{lies}"


def cases() -> list[Case]:
    """Every change on level and on sloping ground with full and partial TINs; full TINs with an
    error of position too.
    """
    return [
        Case(change, slope, ratio, position)
        for position, ratio in ((0.0, 1.0), (0.0, 0.4), (0.01, 1.0))
        for change in CHANGES
        for slope in (0.0, 0.3)
        if slope or not position
    ]


def survey(height: Callable[[F64, F64], F64], case: Case, rng: np.random.Generator) -> Epoch:
    """One survey of heights through the filter."""
    n = rng.poisson(DENSITY * SIDE**2)
    xy = rng.uniform(0.0, SIDE, (n, 2))
    r = np.c_[xy, height(*xy.T)] + NOISE * rng.normal(size=(n, 3))
    r[:, 2] += case.position_m * rng.normal()
    t = np.linspace(0, SECONDS * 10**9, SECONDS * 10, dtype=np.int64)
    C = np.zeros((len(t), 6, 6))
    C[:, 2, 2] = case.position_m**2
    zero = np.zeros((len(t), 3))
    states = PlatformStates(
        t,
        np.tile([0.5 * SIDE, 0.5 * SIDE, 30.0], (len(t), 1)),
        np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)),
        zero,
        zero,
        C,
        np.zeros(len(t), np.int64),
    )
    points = MappedPoints(
        np.sort(rng.integers(0, t[-1], n)),
        r,
        np.tile(np.array([NOISE**2, 0, 0, NOISE**2, 0, NOISE**2], np.float32), (n, 1)),
        rng.integers(0, 16, n).astype(np.uint16),
        np.zeros(n, np.float32),
    )
    parameters = Parameters.read(
        {
            "filter": {"radius_m": 0.4},
            "budget": EXACT,
            "volume": {"vertex_ratio": case.ratio},
        }
    )
    rmls, estimator = SurfaceFilter(parameters), VolumeEstimator(parameters)
    rmls.add_platform(states)
    estimator.add_platform(states)
    rmls.add(points)
    update = rmls.finish()
    assert update is not None
    estimator.add(update)
    return estimator.epoch()


def truth(change: Change, new: Epoch, old: Epoch) -> tuple[float, float]:
    """Cut and fill, m³, of a change over the common footprint of two surveys."""
    middles = cells(new.tin.vertices[new.tin.triangles[new.tin.relevant]])
    both = middles[interpolation(old.tin, np.ascontiguousarray(middles[:, :2]))[2]]
    d = change(both[:, 0], both[:, 1])
    return float(np.maximum(d, 0.0) @ both[:, 2]), float(np.maximum(-d, 0.0) @ both[:, 2])


def cells(corners: F64, parts: int = 6) -> F64:
    """Middles and areas (k, 3) of the small triangles that triangles (m, 3, 3) are divided into."""
    i, j = np.meshgrid(np.arange(parts), np.arange(parts), indexing="ij")
    up, down = i + j < parts, i + j < parts - 1
    s = np.r_[(i[up] + 1 / 3), (i[down] + 2 / 3)] / parts
    t = np.r_[(j[up] + 1 / 3), (j[down] + 2 / 3)] / parts
    a, b, c = corners[:, None, 0, :2], corners[:, None, 1, :2], corners[:, None, 2, :2]
    xy = a + s[None, :, None] * (b - a) + t[None, :, None] * (c - a)
    e, f = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0]) / parts**2
    return np.c_[xy.reshape(-1, 2), np.repeat(area, len(s))]


def errors(case: Case, draws: int, seed: int) -> F64:
    """Errors of cut, fill and net in their standard deviations (draws, 3)."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(draws):
        change, turn = CHANGES[case.change](rng), rng.uniform(0.0, 2.0 * np.pi)
        slope = case.slope * rng.uniform(0.3, 1.0)
        ax, ay = slope * np.cos(turn), slope * np.sin(turn)
        new = survey(lambda x, y, c=change, a=ax, b=ay: c(x, y) + a * x + b * y, case, rng)
        old = survey(lambda x, y, a=ax, b=ay: a * x + b * y, case, rng)
        d = epoch_difference(new, old)[0]
        v = d.volume
        cut, fill = truth(change, new, old)
        out.append(
            [
                (v.cut_m3 - cut) / d.sigma_cut_m3,
                (v.fill_m3 - fill) / d.sigma_fill_m3,
                (v.volume_m3 - cut + fill) / v.sigma_m3,
            ]
        )
    return np.array(out)


def row(z: F64) -> str:
    """z and coverage in words."""
    held = (np.abs(z) < 1.96).mean(axis=0)
    return ", ".join(
        f"{name} {m:+.2f} ± {s:.2f} ({100 * share:.1f} %)"
        for name, m, s, share in zip(
            ("cut", "fill", "net"), z.mean(axis=0), z.std(axis=0), held, strict=True
        )
    )


def run(draws: int = 300) -> dict[str, float | int | str]:
    """The figures of docs/epochs.md."""
    out: dict[str, float | int | str] = {"draws of each": draws}
    for seed, case in enumerate(cases()):
        out[case.words()] = row(errors(case, draws, 7_240_000 + seed))
        print(f"{case.words()} : {out[case.words()]}", file=sys.stderr, flush=True)
    return out


if __name__ == "__main__":
    for key, value in run().items():
        print(f"{key} : {value}")

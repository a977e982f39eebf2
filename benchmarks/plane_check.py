"""Which points of a real cloud lie on a plane, told without anything of the filter: the yardstick
for what a filter must keep, and for the noise that it believes.

Around a point the neighbours in a ball are searched for the plane with the most of them within a
tolerance (RANSAC, Fischler and Bolles 1981). The point is *confirmed* where it is one of them, they
are more than half of at least 15 and come from at least three rings: along one ring a cloud is
smooth whatever its noise, across rings it is not. The root mean square of their distances from
their least squares plane is the noise there, and whatever shape the tolerance lets through: kerbs,
leaves and bends of less than 6 cm. So it is an upper bound.

The lower bound is what no shape makes: how far a return lies from the middle of those beside it on
its ring (second differences over √1.5), and how far each ring lies off in the mean of all places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.truth import F64, I64, Mask

RINGS, SHARE = 3, 0.5
TRIES, MOST, FEWEST = 64, 400, 15
#: Rings are told apart where sorted elevations leave a gap of this, degrees.
RING_GAP_DEG = 0.1
#: Without rings the inliers must not lie on one line: their second extent over the first.
ACROSS = 0.25


@dataclass(frozen=True)
class Yardstick:
    """Ball about a point: radius the largest of ``least_m``, ``widening`` times the range, and
    ``beyond`` times the distance of the nearest point of the third ring · tolerance_m : of an
    inlier
    """

    least_m: float = 0.25
    widening: float = 0.03
    beyond: float = 1.25
    tolerance_m: float = 0.06


@dataclass(frozen=True)
class Cloud:
    """r (n, 3) m, the sensor at the origin where there are rings · ring (n,) or None where none are
    known: then inliers must only not lie on one line
    """

    name: str
    r: F64
    ring: I64 | None
    yardstick: Yardstick


@dataclass(frozen=True)
class Checked:
    """sample (s,) points looked at · confirmed (s,) · rms_m (s,) noise where confirmed, else NaN ·
    repeat_m : the lower bound of the noise, NaN without rings
    """

    sample: I64
    confirmed: Mask
    rms_m: F64
    repeat_m: float


class Repeats:
    """Sums over the planes of a cloud: second differences along rings, and offsets of rings."""

    def __init__(self, cloud: Cloud) -> None:
        assert cloud.ring is not None
        self.cloud, self.beside = cloud, beside_on_ring(cloud.r, cloud.ring)
        self.squares: list[F64] = []
        self.offsets: dict[int, list[float]] = {}

    def add(self, on: I64, off: F64, normal: F64) -> None:
        """A plane with its inliers ``on`` (k,), their distances (k,) m and its normal."""
        assert self.cloud.ring is not None
        ring, beam = self.cloud.ring[on], self.cloud.r[on].mean(axis=0)
        sign = np.sign(beam @ normal)
        near = self.beside[on] @ normal
        near = near[np.abs(near) <= self.cloud.yardstick.tolerance_m]
        self.squares.append(near[np.isfinite(near)] ** 2 / 1.5)
        for k in np.unique(ring).tolist():
            self.offsets.setdefault(k, []).append(float(sign * off[ring == k].mean()))

    def noise_m(self) -> float:
        """Both together."""
        squares = np.concatenate([*self.squares, np.zeros(0)])
        if not len(squares):
            return np.nan
        each = list(self.offsets.values())
        mean = np.average([np.mean(o) ** 2 for o in each], weights=[len(o) for o in each])
        return float(np.sqrt(squares.mean() + mean))


def beside_on_ring(r: F64, ring: I64) -> F64:
    """Each point (n, 3) m less the middle of the two beside it on its ring, NaN where one is
    missing.
    """
    out, azimuth = np.full(r.shape, np.nan), np.arctan2(r[:, 1], r[:, 0])
    for k in np.unique(ring):
        own = np.flatnonzero(ring == k)
        own = own[np.argsort(azimuth[own])]
        gap = np.diff(azimuth[own])
        usual = np.median(gap[gap > 0]) if (gap > 0).any() else 0.0
        near = (gap > 0.3 * usual) & (gap < 2.5 * usual)
        both = near[:-1] & near[1:] & (np.abs(np.diff(gap)) < 0.5 * usual)
        a, b, c = own[:-2][both], own[1:-1][both], own[2:][both]
        out[b] = r[b] - 0.5 * (r[a] + r[c])
    return out


def rings_by_elevation(r: F64) -> I64:
    """Ring (n,) of points (n, 3) about the sensor, upwards, from gaps between their elevations."""
    elevation = np.degrees(np.arctan2(r[:, 2], np.hypot(r[:, 0], r[:, 1])))
    order = np.argsort(elevation)
    out = np.empty(len(r), np.int64)
    out[order] = np.cumsum(np.diff(elevation[order], prepend=elevation[order[0]]) > RING_GAP_DEG)
    return out


def check(cloud: Cloud, samples: int = 1500, seed: int = 0) -> Checked:
    """Look at random points; those at the sensor itself (no return) are none."""
    rng = np.random.default_rng(seed)
    range_m = np.linalg.norm(cloud.r, axis=1)
    there = np.flatnonzero(range_m > 0.1) if cloud.ring is not None else np.arange(len(cloud.r))
    sample = np.sort(rng.choice(there, min(samples, len(there)), replace=False))
    rule = cloud.yardstick
    balls = np.full(len(sample), rule.least_m)
    if cloud.ring is not None:
        third = rule.beyond * third_ring(cloud.r, cloud.ring, sample)
        balls = np.maximum(np.maximum(balls, rule.widening * range_m[sample]), third)
    rms = np.full(len(sample), np.nan)
    tree = cKDTree(cloud.r)
    repeats = Repeats(cloud) if cloud.ring is not None else None
    for i, (at, ball) in enumerate(zip(sample, balls, strict=True)):
        near = np.array(tree.query_ball_point(cloud.r[at], ball))
        near = near[near != at]
        if len(near) > MOST:
            near = rng.choice(near, MOST, replace=False)
        if len(near) >= FEWEST:
            rms[i] = _rms(cloud, np.append(at, near), rng, repeats)
    lower = np.nan if repeats is None else repeats.noise_m()
    return Checked(sample, np.isfinite(rms), rms, lower)


def third_ring(r: F64, ring: I64, sample: I64) -> F64:
    """Distance (s,) m of points ``sample`` (s,) from the nearest point of the third nearest ring,
    their own being the first.
    """
    each = [cKDTree(r[ring == k]).query(r[sample])[0] for k in np.unique(ring)]
    return np.asarray(np.sort(each, axis=0)[min(RINGS, len(each)) - 1])


def _rms(cloud: Cloud, near: I64, rng: np.random.Generator, repeats: Repeats | None) -> float:
    """Noise about the plane through the first of the points ``near``, NaN where it has none."""
    x = cloud.r[near] - cloud.r[near[0]]
    three = rng.integers(0, len(x), (TRIES, 3))
    if cloud.ring is not None:  # three points of one ring tell no plane
        own = cloud.ring[near]
        three = three[(own[three] != own[three[:, :1]]).any(axis=1)]
    a, b, c = x[three[:, 0]], x[three[:, 1]], x[three[:, 2]]
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    a, normal = a[length > 0], normal[length > 0] / length[length > 0, None]
    if not len(a):
        return np.nan
    distance = np.abs(normal @ x.T - np.einsum("ti,ti->t", normal, a)[:, None])
    inside = distance <= cloud.yardstick.tolerance_m
    on = inside[np.argmax(inside.sum(axis=1))]
    for _ in range(3):
        middle = x[on].mean(axis=0)
        _, size, axes = np.linalg.svd(x[on] - middle, full_matrices=False)
        off = (x - middle) @ axes[2]
        on = np.abs(off) <= cloud.yardstick.tolerance_m
        if on.sum() < FEWEST:
            return np.nan
    if not on[0] or np.mean(on[1:]) <= SHARE or not _several(cloud, near[on], size):
        return np.nan
    if repeats is not None:
        repeats.add(near[on], off[on], axes[2])
    return float(np.sqrt(np.sum(off[on] ** 2) / (on.sum() - 3)))


def _several(cloud: Cloud, inliers: I64, size: F64) -> bool:
    """Whether inliers come from several rings, or without rings from no single line."""
    if cloud.ring is not None:
        return len(np.unique(cloud.ring[inliers])) >= RINGS
    return bool(size[1] >= ACROSS * size[0])

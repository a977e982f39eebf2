"""The thesis's square (seed 002 chapter 9 and section 9.5) as a synthetic cloud with classes and
exact truth.

27 x 27 m of level paving with benches, the ring of a fountain, lamps and trees, the whole tilted by
10 mrad; 2.7 million points give the thesis's 3,700 points per m². Surfaces carry uniform noise of 5
cm along their normal. Crowns are points anywhere in a ball: no surface. A hundred outliers lie
anywhere in the box.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.shapes import FAR_M, NOISE_M, OUTLIERS, Result, rms_mm
from benchmarks.truth import F64, I64, Mask, box_faces, sample_polygons, to_polygons

CLASSES = ("ground", "bench", "fountain", "lamp", "trunk", "crown", "outlier")
GROUND, BENCH, FOUNTAIN, LAMP, TRUNK, CROWN, OUTLIER = range(7)
SIDE_M, TILT_RAD, POINTS = 27.0, 0.01, 2_700_000
BENCHES = ((0.0, 0.6), (-6.0, 4.0), (6.0, 4.0), (-6.0, 8.0), (0.0, 9.0), (6.0, 8.0))
LAMPS = ((-12.0, -12.0), (12.0, -12.0), (-12.0, 1.0), (12.0, 1.0))
TREES = ((-10.0, 10.5), (-3.5, 11.0), (3.5, 11.0), (10.0, 10.5), (-10.0, -6.0), (10.0, -6.0))
BENCH_SIZE_M = (1.8, 0.5, 0.45)
#: Profiles (radius, height) of bodies of revolution, their outside to the right of the way they are
#: drawn.
RING = np.array([(4.0, 0.0), (4.0, 0.5), (3.6, 0.5), (3.6, 0.0)])
POST = np.array([(0.1, 0.0), (0.1, 3.5), (0.25, 3.6), (0.25, 4.0), (0.0, 4.0)])
STEM = np.array([(0.25, 0.0), (0.18, 2.4)])
CROWN_M, CROWN_HEIGHT_M, CROWN_SHARE = 2.0, 4.2, 0.1


@dataclass(frozen=True)
class Revolved:
    """A profile (k, 2) of radius and height turned about the vertical through ``centre``."""

    kind: int
    centre: tuple[float, float]
    profile: F64

    def segments(self) -> Iterator[tuple[F64, F64]]:
        """Its lines in the half plane."""
        yield from zip(self.profile[:-1], self.profile[1:], strict=True)

    def area(self) -> float:
        """Sum of the frusta, m²."""
        return float(sum(np.pi * (a[0] + b[0]) * np.linalg.norm(b - a) for a, b in self.segments()))

    def box(self) -> tuple[F64, F64]:
        """Corners of the bounding box."""
        reach, (low, high) = self.profile[:, 0].max(), self.profile[[0, -1], 1]
        x, y = self.centre
        return np.array([x - reach, y - reach, min(low, high, 0.0)]), np.array(
            [x + reach, y + reach, self.profile[:, 1].max()]
        )

    def covers(self, x: F64, y: F64) -> Mask:
        """Where there is no paving below."""
        inner, outer = self.foot()
        rho = np.hypot(x - self.centre[0], y - self.centre[1])
        out: Mask = (rho < outer) & ((rho > inner) | (inner == 0.0))
        return out

    def foot(self) -> tuple[float, float]:
        """Inner and outer radius on the paving; the inner one is 0 where the body is full."""
        radii = self.profile[self.profile[:, 1] == 0.0, 0]
        return (radii.min() if len(radii) > 1 else 0.0), radii.max()

    def footprint(self) -> float:
        """m² of paving it stands on."""
        inner, outer = self.foot()
        return float(np.pi * (outer**2 - inner**2))

    def distance(self, points: F64) -> F64:
        """Exact (n,) m: the nearest point of a body of revolution lies in the same half plane."""
        at = np.stack(
            [np.hypot(points[:, 0] - self.centre[0], points[:, 1] - self.centre[1]), points[:, 2]],
            axis=1,
        )
        best = np.full(len(points), np.inf)
        for a, b in self.segments():
            t = np.clip((at - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            np.minimum(best, np.linalg.norm(at - a - t[:, None] * (b - a), axis=1), out=best)
        return best

    def sample(self, count: int, rng: np.random.Generator) -> tuple[F64, F64]:
        """Points and outward normals, uniform by area: along a frustum the radius weighs."""
        a, b = self.profile[:-1], self.profile[1:]
        length = np.linalg.norm(b - a, axis=1)
        weight = (a[:, 0] + b[:, 0]) * length
        s = rng.choice(len(a), size=count, p=weight / weight.sum())
        u, A, B = rng.random(count), a[s, 0], b[s, 0]
        rho = np.sqrt(A * A + u * (B * B - A * A))
        slanted = np.abs(B - A) > 1e-12
        t = np.where(slanted, (rho - A) / np.where(slanted, B - A, 1.0), u)
        rho, z = A + t * (B - A), a[s, 1] + t * (b[s, 1] - a[s, 1])
        along = (b - a)[s] / length[s, None]
        phi = rng.uniform(0, 2 * np.pi, count)
        c, d = np.cos(phi), np.sin(phi)
        points = np.stack([self.centre[0] + rho * c, self.centre[1] + rho * d, z], axis=1)
        return points, np.stack([along[:, 1] * c, along[:, 1] * d, -along[:, 0]], axis=1)


@dataclass(frozen=True)
class Box:
    """A box on the paving: four sides and the top."""

    kind: int
    centre: tuple[float, float]

    def box(self) -> tuple[F64, F64]:
        """Its corners."""
        half = np.array(BENCH_SIZE_M) / 2
        middle = np.array([*self.centre, half[2]])
        return middle - half, middle + half

    def footprint(self) -> float:
        """m² of paving it stands on."""
        return BENCH_SIZE_M[0] * BENCH_SIZE_M[1]

    def area(self) -> float:
        """m², without the bottom."""
        x, y, z = BENCH_SIZE_M
        return x * y + 2 * (x + y) * z

    def covers(self, x: F64, y: F64) -> Mask:
        """Where there is no paving below."""
        low, high = self.box()
        out: Mask = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
        return out

    def distance(self, points: F64) -> F64:
        """Exact (n,) m."""
        out: F64 = np.linalg.norm(
            points - to_polygons(box_faces(*self.box())[1:])(points)[0], axis=1
        )
        return out

    def sample(self, count: int, rng: np.random.Generator) -> tuple[F64, F64]:
        """Points and outward normals, uniform by area."""
        return sample_polygons(box_faces(*self.box())[1:], count, rng)


BODIES: tuple[Revolved | Box, ...] = (
    *(Box(BENCH, at) for at in BENCHES),
    Revolved(FOUNTAIN, (0.0, -5.0), RING),
    *(Revolved(LAMP, at, POST) for at in LAMPS),
    *(Revolved(TRUNK, at, STEM) for at in TREES),
)
TILT = np.array(
    [
        [np.cos(TILT_RAD), 0.0, np.sin(TILT_RAD)],
        [0.0, 1.0, 0.0],
        [-np.sin(TILT_RAD), 0.0, np.cos(TILT_RAD)],
    ]
)


@dataclass(frozen=True)
class Square:
    """Points (n, 3) m in random order and the class of each (n,), an index into ``CLASSES``."""

    points: F64
    label: I64

    def level(self, points: F64) -> F64:
        """Points (k, 3) in the frame whose z = 0 is the paving."""
        out: F64 = points @ TILT
        return out

    def distance(self, points: F64) -> F64:
        """Exact distance (k,) m to the nearest surface of whatever class; crowns have none. The
        paving goes on beyond the rim.

        A body is only computed for points nearer to its bounding box than to what was found before.
        """
        p = self.level(points)
        best = np.abs(p[:, 2])
        for body in BODIES:
            best[body.covers(p[:, 0], p[:, 1])] = np.inf
        for body in BODIES:
            low, high = body.box()
            candidates = np.flatnonzero(
                np.all((p > low - best[:, None]) & (p < high + best[:, None]), axis=1)
            )
            best[candidates] = np.minimum(best[candidates], body.distance(p[candidates]))
        return best


def paving(count: int, rng: np.random.Generator) -> F64:
    """Points (count, 3) on the paving, outside what stands on it."""
    xy = np.zeros((0, 2))
    while len(xy) < count:
        more = rng.uniform(-SIDE_M / 2, SIDE_M / 2, (count - len(xy) + 1000, 2))
        xy = np.concatenate([xy, more[~np.any([body.covers(*more.T) for body in BODIES], axis=0)]])
    return np.column_stack([xy[:count], np.zeros(count)])


def square(n: int = POINTS, seed: int = 0) -> Square:
    """``n`` points: a tenth in the crowns, a hundred outliers, the rest on the surfaces, uniform by
    area.
    """
    rng = np.random.default_rng([seed, 10])
    crowns = round(CROWN_SHARE * n)
    areas = np.array([body.area() for body in BODIES])
    open_area = SIDE_M**2 - sum(body.footprint() for body in BODIES)
    counts = rng.multinomial(
        n - crowns - OUTLIERS, np.array([open_area, *areas]) / (open_area + areas.sum())
    )
    up = np.array([0.0, 0.0, 1.0])
    parts = [paving(counts[0], rng) + rng.uniform(-NOISE_M, NOISE_M, (counts[0], 1)) * up]
    for body, count in zip(BODIES, counts[1:], strict=True):
        at, normal = body.sample(count, rng)
        parts.append(at + rng.uniform(-NOISE_M, NOISE_M, (count, 1)) * normal)
    ball = rng.normal(size=(crowns, 3))
    ball *= CROWN_M * np.cbrt(rng.random((crowns, 1))) / np.linalg.norm(ball, axis=1, keepdims=True)
    parts.append(
        ball
        + np.column_stack(
            [np.array(TREES)[rng.integers(0, len(TREES), crowns)], np.full(crowns, CROWN_HEIGHT_M)]
        )
    )
    low, high = (
        np.array([f(part[:, i]) for part in parts for i in range(3)]).reshape(-1, 3)
        for f in (np.min, np.max)
    )
    parts.append(rng.uniform(low.min(axis=0), high.max(axis=0), (OUTLIERS, 3)))
    kinds = [GROUND, *(body.kind for body in BODIES), CROWN, OUTLIER]
    label = np.repeat(kinds, [len(part) for part in parts])
    order = rng.permutation(n)
    return Square(np.concatenate(parts)[order] @ TILT.T, label[order])


def window(whole: Square, side: float) -> Square:
    """The part within ``side`` m about the origin: a bench and a piece of the fountain when it is
    small.
    """
    inside = np.all(np.abs(whole.points[:, :2]) <= side / 2, axis=1)
    return Square(whole.points[inside], whole.label[inside])


def bench_and_fountain(seed: int = 0, count: int = 135_100) -> Square:
    """The thesis's first cloud: 3,680 points per m² over 36.7 m²."""
    part = window(square(POINTS, seed), np.sqrt(1.02 * count / 3680))
    return Square(part.points[:count], part.label[:count])


def score(whole: Square, result: Result) -> dict[str, float]:
    """RMS over kept points of all surfaces and of each class (mm), mean height of kept paving
    points over the paving (mm), shares kept of each class and of far outliers taken out (%).
    Classes that are not there are left out.
    """
    label = whole.label[result.index]
    error = whole.distance(result.r)
    surface = label < CROWN
    out = {
        "rms_mm": rms_mm(error[surface]),
        "ground_bias_mm": float(1e3 * np.mean(whole.level(result.r[label == GROUND])[:, 2])),
    }
    before, after = (np.bincount(labels, minlength=len(CLASSES)) for labels in (whole.label, label))
    for kind in np.flatnonzero(before):
        if kind < CROWN:
            out[f"{CLASSES[kind]}_rms_mm"] = rms_mm(error[label == kind])
        out[f"{CLASSES[kind]}_kept_pct"] = float(100 * after[kind] / before[kind])
    stray = np.flatnonzero(whole.label == OUTLIER)
    far = stray[whole.distance(whole.points[stray]) > FAR_M]
    out["far_removed_pct"] = (
        float(100 * np.mean(~np.isin(far, result.index))) if len(far) else float("nan")
    )
    removed = whole.label[result.outliers]
    out["false_removed_pct"] = float(100 * np.sum(removed < CROWN) / np.sum(whole.label < CROWN))
    return out

"""Coverage of the standard deviations that ``ladar_volume body`` prints: piles, boxes, houses,
boulders, logs, bowls and pipes of many sizes and densities, each with 1 % of stray points.

Every cloud goes through the command line with nothing set. An answer is right where its error is
within two standard deviations; it may be off where it is doubtful or refused with a reason. An
error of more than three standard deviations with a sound verdict is *silent*: there must be none.

``python -m benchmarks.body_coverage [KIND ...] [--seeds N] [--first SEED]``
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.bodies import Sample, ball, disc, joined, pipe
from benchmarks.truth import F64, box_faces, rotation, sample_polygons
from ladar_volume.cli.main import main as ladar_volume
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.simulation.scenes import Ground

SEEDS = 10
#: Share of stray points, and how far above the highest point their box reaches.
STRAY, ABOVE = 0.01, 1.3


@dataclass(frozen=True)
class Scene:
    """points : (n, 3) m, with noise and strays · volume_m3 : (b,) exact, the largest first ·
    stands : whether on a ground · words : what was drawn
    """

    points: F64
    volume_m3: tuple[float, ...]
    stands: bool
    words: str


Maker = Callable[[np.random.Generator], Scene]


def scene(
    sample: Sample,
    noise_m: float,
    volume_m3: tuple[float, ...],
    words: str,
    rng: np.random.Generator,
    stands: bool = True,
) -> Scene:
    """Normal noise along the normal, strays anywhere in the box, a random order; what stands
    nowhere in a random orientation.
    """
    at, normals = sample
    p = at + noise_m * rng.normal(size=(len(at), 1)) * normals
    low, high = p.min(axis=0), p.max(axis=0)
    if stands:
        high[2] = low[2] + ABOVE * (high[2] - low[2])
    p = np.concatenate([p, rng.uniform(low, high, (int(STRAY * len(p)), 3))])
    if not stands:
        p = p @ rotation(rng).T + rng.uniform(-5.0, 5.0, 3)
    density = f"{len(at):,} points, noise {1e3 * noise_m:.1f} mm"
    return Scene(p[rng.permutation(len(p))], volume_m3, stands, f"{words}, {density}")


def ground_around(
    half_m: tuple[float, ...], count: int, covered: Callable[[F64], F64], rng: np.random.Generator
) -> Sample:
    """Level points around what is ``covered``, a mask (n,) of (n, 2)."""
    xy = rng.uniform(-1.0, 1.0, (count, 2)) * np.array(half_m)
    xy = xy[~np.asarray(covered(xy), bool)]
    return np.column_stack([xy, np.zeros(len(xy))]), np.tile([0.0, 0.0, 1.0], (len(xy), 1))


def both(a: Sample, b: Sample) -> Sample:
    """Two samples together."""
    return np.concatenate([a[0], b[0]]), np.concatenate([a[1], b[1]])


def cones(
    rng: np.random.Generator, tops: list[tuple[float, float, float, float]], density: float
) -> Sample:
    """Piles (x, y, radius, height) on level ground, as even in plan as seen from above."""
    t = np.array(tops)
    low, high = (t[:, :2] - 2 * t[:, 2:3]).min(axis=0), (t[:, :2] + 2 * t[:, 2:3]).max(axis=0)
    xy = rng.uniform(low, high, (rng.poisson(density * np.prod(high - low)), 2))
    z, n = np.zeros(len(xy)), np.tile([0.0, 0.0, 1.0], (len(xy), 1))
    for x, y, radius, height in tops:
        d = xy - (x, y)
        away = np.hypot(*d.T)
        own = away < radius
        z[own] = height * (1.0 - away[own] / radius)
        n[own, :2] = d[own] / away[own, None] * height / radius
    return np.column_stack([xy, z]), n / np.linalg.norm(n, axis=1)[:, None]


def cone_m3(radius: float, height: float) -> float:
    """Volume of a cone."""
    return np.pi * radius**2 * height / 3.0


def pile(rng: np.random.Generator, densities: tuple[float, ...] = (1.0, 2.0, 8.0, 30.0)) -> Scene:
    """A cone at an angle of repose."""
    density = float(rng.choice(densities))
    radius = rng.uniform(6.0, 15.0) if density < 20 else rng.uniform(3.0, 5.0)
    height = radius * np.tan(np.radians(rng.uniform(27.0, 38.0)))
    p = cones(rng, [(*rng.uniform(-1, 1, 2), radius, height)], density)
    words = f"radius {radius:.1f} m, {density:g}/m²"
    return scene(p, rng.uniform(0.01, 0.03), (cone_m3(radius, height),), words, rng)


def sparse_pile(rng: np.random.Generator) -> Scene:
    """A cone with 0.3 to 1 points per square metre."""
    return pile(rng, (0.3, 0.5, 1.0))


def two_piles(rng: np.random.Generator) -> Scene:
    """A large and a small cone."""
    R, r = rng.uniform(8.0, 12.0), rng.uniform(3.0, 5.0)
    H, h = 0.6 * R, rng.uniform(0.4, 0.7) * r
    density = float(rng.choice((2.0, 8.0)))
    p = cones(rng, [(0.0, 0.0, R, H), (R + 2.5 * r, 0.0, r, h)], density)
    words = f"radii {R:.1f} and {r:.1f} m, {density:g}/m²"
    return scene(p, rng.uniform(0.01, 0.02), (cone_m3(R, H), cone_m3(r, h)), words, rng)


def box(rng: np.random.Generator) -> Scene:
    """A box on the ground."""
    a = rng.uniform(0.5, 3.0, 3)
    spacing = float(np.cbrt(a.prod())) / rng.uniform(12.0, 30.0)
    faces = box_faces(np.array([-a[0] / 2, -a[1] / 2, 0.0]), np.array([a[0] / 2, a[1] / 2, a[2]]))
    area = a[0] * a[1] + 2 * a[2] * (a[0] + a[1])
    shell = sample_polygons(faces[1:], int(area / spacing**2), rng)
    floor = ground_around(
        (1.5 * a[0], 1.5 * a[1]),
        int(9 * a[0] * a[1] / spacing**2),
        lambda q: (abs(q) < a[:2] / 2).all(axis=1),
        rng,
    )
    words = "×".join(f"{x:.2f}" for x in a) + f" m, spacing {100 * spacing:.1f} cm"
    noise = rng.uniform(0.1, 0.3) * spacing
    return scene(both(shell, floor), noise, (float(a.prod()),), words, rng)


def box_on_rough_ground(rng: np.random.Generator) -> Scene:
    """A box on ground that undulates by 5 to 20 mm over half a metre to one and a half."""
    a = rng.uniform((1.0, 1.0, 0.6), (3.0, 3.0, 2.0))
    ground = Ground(
        rough_m=rng.uniform(0.005, 0.02),
        length_m=rng.uniform(0.5, 1.5),
        seed=int(rng.integers(1 << 31)),
    )
    x, y = a[:2] / 2
    spacing = float(np.cbrt(a.prod())) / rng.uniform(15.0, 30.0)
    faces = box_faces(np.array([-x, -y, -0.1]), np.array([x, y, a[2]]))[1:]
    area = 4 * x * y + 4 * (a[2] + 0.1) * (x + y)
    at, n = sample_polygons(faces, int(area / spacing**2), rng)
    seen = at[:, 2] > ground(*at[:, :2].T)
    half = tuple(a[:2] / 2 + 2.0)
    count = int(4 * half[0] * half[1] / spacing**2)
    floor, up = ground_around(half, count, lambda q: (abs(q) < (x, y)).all(axis=1), rng)
    floor[:, 2] = ground(*floor[:, :2].T)
    truth = 4 * x * y * (a[2] - ground.mean_over_box(-x, x, -y, y))
    words = "×".join(f"{s:.2f}" for s in a) + f" m, ground ±{1e3 * ground.rough_m:.0f} mm"
    noise = rng.uniform(0.1, 0.3) * spacing
    return scene(both((at[seen], n[seen]), (floor, up)), noise, (float(truth),), words, rng)


def house(rng: np.random.Generator) -> Scene:
    """A house with a gable roof, 0.2 to 0.5 m between points."""
    a, b, h, g = rng.uniform(8, 12), rng.uniform(6, 9), rng.uniform(2.5, 5), rng.uniform(1.5, 3)
    x, y = a / 2, b / 2
    faces = [
        np.array(c, float)
        for c in (
            [(-x, -y, 0), (x, -y, 0), (x, -y, h), (-x, -y, h)],
            [(x, y, 0), (-x, y, 0), (-x, y, h), (x, y, h)],
            [(x, -y, 0), (x, y, 0), (x, y, h), (x, 0, h + g), (x, -y, h)],
            [(-x, y, 0), (-x, -y, 0), (-x, -y, h), (-x, 0, h + g), (-x, y, h)],
            [(-x, -y, h), (x, -y, h), (x, 0, h + g), (-x, 0, h + g)],
            [(x, y, h), (-x, y, h), (-x, 0, h + g), (x, 0, h + g)],
        )
    ]
    spacing = float(rng.choice([0.2, 0.3, 0.5]))
    area = 2 * h * (a + b) + b * g + 2 * a * np.hypot(y, g)
    shell = sample_polygons(faces, int(area / spacing**2), rng)
    floor = ground_around(
        (1.2 * a, 1.2 * b),
        int(5.76 * a * b / spacing**2),
        lambda q: (abs(q) < (x, y)).all(axis=1),
        rng,
    )
    words = f"{a:.1f}×{b:.1f} m, eaves {h:.1f} m, spacing {spacing:g} m"
    noise = rng.uniform(0.01, 0.02)
    return scene(both(shell, floor), noise, (a * b * (h + g / 2),), words, rng)


def boulder(rng: np.random.Generator, seen: float = -1.0) -> Scene:
    """An ellipsoid that stands on less than it covers. seen : least upward share of the normals
    of what was seen
    """
    a = rng.uniform(0.5, 1.5) * np.array([1.0, rng.uniform(0.7, 1.0), rng.uniform(0.6, 0.9)])
    depth = rng.uniform(0.5, 0.85)
    spacing = float(np.cbrt(a.prod())) / rng.uniform(5.0, 20.0)
    unit = rng.normal(size=(int(4.2 * np.pi * (a.prod() ** (2 / 3)) / spacing**2 * 2.2), 3))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    weight = np.linalg.norm(unit / a, axis=1)  # area of the ellipsoid by that of the ball
    unit = unit[rng.uniform(0, weight.max(), len(unit)) < weight]
    n = unit / a
    n /= np.linalg.norm(n, axis=1)[:, None]
    own = (unit[:, 2] > -depth) & (n[:, 2] >= seen)
    shell = (unit * a + (0.0, 0.0, depth * a[2]))[own], n[own]
    reach = 1.0 - depth**2 if seen <= -1.0 else 1.0
    floor = ground_around(
        (2.5 * a[0], 2.5 * a[1]),
        int(25 * a[0] * a[1] / spacing**2),
        lambda q: ((q / a[:2]) ** 2).sum(axis=1) < reach,
        rng,
    )
    truth = np.pi * a.prod() * (2 / 3 + depth - depth**3 / 3)
    words = f"{2 * a[0]:.2f} m long, middle {depth:.2f} of its half height up"
    noise = rng.uniform(0.1, 0.3) * spacing
    return scene(both(shell, floor), noise, (float(truth),), words, rng)


def boulder_from_above(rng: np.random.Generator) -> Scene:
    """An ellipsoid whose underside, and the ground below it, was not seen, or hardly."""
    return boulder(rng, float(rng.choice([0.0, -0.2, -0.4])))


def log(rng: np.random.Generator) -> Scene:
    """A log on the ground, seen all round."""
    r, length, depth = rng.uniform(0.2, 0.5), rng.uniform(2.0, 4.0), rng.uniform(0.6, 0.9)
    spacing = r / rng.uniform(6.0, 12.0)
    side = pipe(int(2 * np.pi * r * length / spacing**2), rng, r, -length / 2, length / 2)
    ends = [
        disc(int(np.pi * r * r / spacing**2), rng, 0.0, r, z * length / 2, z) for z in (-1.0, 1.0)
    ]
    at, n = both(both(side, ends[0]), ends[1])
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    at, n = at @ turn.T + (0.0, 0.0, depth * r), n @ turn.T
    own = at[:, 2] > 0
    wide = r * np.sqrt(1 - depth**2)
    floor = ground_around(
        (length, 5 * r),
        int(20 * length * r / spacing**2),
        lambda q: (abs(q[:, 0]) < length / 2) & (abs(q[:, 1]) < wide),
        rng,
    )
    section = r * r * (np.pi - np.arccos(depth) + depth * np.sqrt(1 - depth**2))
    words = f"radius {r:.2f} m, {length:.1f} m long, middle {depth:.2f} r up"
    noise = rng.uniform(0.1, 0.3) * spacing
    return scene(both((at[own], n[own]), floor), noise, (section * length,), words, rng)


def bowl(rng: np.random.Generator) -> Scene:
    """Half a shell of 1 m, its wall 8 cm thick, seen from all sides."""
    noise, inner = float(rng.choice([0.003, 0.005, 0.01])), 0.92
    count = int(rng.choice([8000, 16000]))

    def inside(n: int, g: np.random.Generator) -> Sample:
        p, normal = ball(n, g, inner, 0.0)
        return p, -normal

    at = joined(
        [
            (2 * np.pi, lambda n, g: ball(n, g, 1.0, 0.0)),
            (2 * np.pi * inner**2, inside),
            (np.pi * (1 - inner**2), lambda n, g: disc(n, g, inner, 1.0, 0.0, -1.0)),
        ],
        count,
        rng,
    )
    truth = 2 / 3 * np.pi * (1 - inner**3)
    return scene(at, noise, (float(truth),), "wall 8 cm", rng, stands=False)


def tube(rng: np.random.Generator) -> Scene:
    """A pipe of 0.6 m with a wall of 4 to 8 cm, seen from all sides."""
    R, length, wall = 0.3, 2.0, float(rng.choice([0.04, 0.06, 0.08]))
    r, half = R - wall, length / 2

    def inside(n: int, g: np.random.Generator) -> Sample:
        p, normal = pipe(n, g, r, -half, half)
        return p, -normal

    at = joined(
        [
            (2 * np.pi * R * length, lambda n, g: pipe(n, g, R, -half, half)),
            (2 * np.pi * r * length, inside),
            (np.pi * (R * R - r * r), lambda n, g: disc(n, g, r, R, half, 1.0)),
            (np.pi * (R * R - r * r), lambda n, g: disc(n, g, r, R, -half, -1.0)),
        ],
        15000,
        rng,
    )
    truth = np.pi * (R * R - r * r) * length
    words = f"wall {100 * wall:.0f} cm"
    return scene(at, float(rng.choice([0.003, 0.005])), (float(truth),), words, rng, stands=False)


def frustum(rng: np.random.Generator, lean_deg: float, unseen: tuple[float, float]) -> Scene:
    """A block whose four walls lean by up to so much, each its own way, and were seen down to some
    height only, each its own within a share of the height.
    """
    a, h = rng.uniform(0.8, 3.0, 2), rng.uniform(0.7, 2.0)
    out = h * np.tan(np.radians(rng.uniform(-lean_deg, lean_deg, 4)))
    low, high = -a / 2 - out[:2], a / 2 + out[2:]
    base = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    top = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * a / 2
    b, t = np.c_[base, np.zeros(4)], np.c_[top, np.full(4, h)]
    faces = [np.array([b[i], b[i - 3], t[i - 3], t[i]]) for i in range(4)] + [t]
    spacing = float(np.cbrt(a.prod() * h)) / rng.uniform(15.0, 35.0)
    at, n = sample_polygons(faces, int((a.prod() + 2 * h * a.sum()) / spacing**2), rng)
    axis = np.argmax(np.abs(n[:, :2]), axis=1)
    side = 2 * axis + (n[np.arange(len(n)), axis] > 0)
    share = rng.uniform(*unseen)
    seen = (n[:, 2] > 0.8) | (at[:, 2] > (h * share * rng.uniform(0.3, 1.0, 4))[side])
    low, high = np.minimum(low, -a / 2), np.maximum(high, a / 2)
    floor = ground_around(
        tuple(1.5 * a + 1.0),
        int((3 * a + 2).prod() / spacing**2),
        lambda q: ((q > low) & (q < high)).all(axis=1),
        rng,
    )
    middle = 0.5 * (base + top)
    truth = h / 6 * (area_of(base) + 4 * area_of(middle) + area_of(top))
    words = f"{a[0]:.1f}×{a[1]:.1f}×{h:.1f} m, walls unseen up to {h * share:.2f} m"
    noise = rng.uniform(0.1, 0.3) * spacing
    return scene(both((at[seen], n[seen]), floor), noise, (float(truth),), words, rng)


def area_of(p: F64) -> float:
    """Area of a polygon (k, 2)."""
    x, y = p.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def upright(rng: np.random.Generator) -> Scene:
    """A box whose walls were not seen down to the ground."""
    return frustum(rng, 0.0, (0.05, 0.3))


def leaning(rng: np.random.Generator) -> Scene:
    """A block with leaning walls that were not seen down to the ground."""
    return frustum(rng, 15.0, (0.05, 0.3))


def on_wheels(rng: np.random.Generator) -> Scene:
    """A box on four blocks, clear of the ground, which is seen below as far as it goes at 30 to 60
    degrees; the underside is not.
    """
    a, h = np.array([rng.uniform(3.0, 6.0), rng.uniform(1.6, 2.4)]), rng.uniform(1.0, 2.0)
    clear, wheel = rng.uniform(0.2, 0.6), np.array([0.6, 0.3])
    into = clear * np.tan(np.radians(rng.uniform(30.0, 60.0)))
    spacing = rng.uniform(0.03, 0.08)
    body = box_faces(np.array([*(-a / 2), clear]), np.array([*(a / 2), clear + h]))
    faces, below = body[1:], []
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        middle = np.array([x, y]) * (a / 2 - wheel / 2 - (0.5, 0.0))
        below.append(middle)
        lo, hi = np.array([*(middle - wheel / 2), 0.0]), np.array([*(middle + wheel / 2), clear])
        faces += box_faces(lo, hi)[2:]
    area = a.prod() + 2 * h * a.sum() + 8 * clear * wheel.sum()
    shell = sample_polygons(faces, int(area / spacing**2), rng)

    def covered(q: F64) -> F64:
        """Deeper under the body than was seen, or below a wheel."""
        deep = (np.abs(q) < a / 2 - into).all(axis=1)
        for middle in below:
            deep |= (np.abs(q - middle) < wheel / 2).all(axis=1)
        return deep

    floor = ground_around(tuple(1.5 * a), int(9 * a.prod() / spacing**2), covered, rng)
    truth = a.prod() * h + 4 * wheel.prod() * clear
    words = f"{a[0]:.1f}×{a[1]:.1f}×{h:.1f} m, {clear:.2f} m clear of the ground"
    noise = rng.uniform(0.1, 0.3) * spacing
    return scene(both(shell, floor), noise, (float(truth),), words, rng)


def cup(rng: np.random.Generator) -> Scene:
    """A cup of 0.6 m with a bottom, its wall 4 to 8 cm thick, seen from all sides."""
    R, h, wall = 0.3, rng.uniform(0.5, 0.9), float(rng.choice([0.04, 0.06, 0.08]))
    r = R - wall

    def inside(n: int, g: np.random.Generator) -> Sample:
        p, normal = pipe(n, g, r, wall, h)
        return p, -normal

    at = joined(
        [
            (2 * np.pi * R * h, lambda n, g: pipe(n, g, R, 0.0, h)),
            (2 * np.pi * r * (h - wall), inside),
            (np.pi * (R * R - r * r), lambda n, g: disc(n, g, r, R, h, 1.0)),
            (np.pi * r * r, lambda n, g: disc(n, g, 0.0, r, wall, 1.0)),
            (np.pi * R * R, lambda n, g: disc(n, g, 0.0, R, 0.0, -1.0)),
        ],
        15000,
        rng,
    )
    truth = np.pi * (R * R * h - r * r * (h - wall))
    noise = float(rng.choice([0.003, 0.005, 0.01]))
    return scene(at, noise, (float(truth),), f"wall {100 * wall:.0f} cm", rng, stands=False)


def car(rng: np.random.Generator) -> Scene:
    """A car with a cabin, closed down to the ground, on a slope of up to 15 degrees, turned."""
    a, b, h = rng.uniform(3.5, 4.8), rng.uniform(1.6, 1.9), rng.uniform(0.7, 0.9)
    top, x0, x1 = h + rng.uniform(0.5, 0.7), rng.uniform(-0.3, -0.1) * a, rng.uniform(0.2, 0.35) * a
    x, y, s = a / 2, b / 2, rng.uniform(0.3, 0.5)
    side = [(-x, 0), (x, 0), (x, h), (x1 + s, h), (x1, top), (x0, top), (x0 - s, h), (-x, h)]
    profile = np.array(side)
    left, right = (np.c_[profile[:, 0], np.full(8, w), profile[:, 1]] for w in (-y, y))
    # a profile is no convex polygon: its body and its cabin are sampled apart
    faces = [left[[0, 1, 2, 7]], left[3:7], right[[7, 2, 1, 0]], right[3:7][::-1]]
    faces += [np.array([left[i], right[i], right[i + 1], left[i + 1]]) for i in range(1, 7)]
    faces += [np.array([left[7], right[7], right[0], left[0]])]
    spacing = rng.uniform(0.03, 0.06)
    area = 2 * area_of(profile) + b * np.linalg.norm(np.diff(profile[1:], axis=0), axis=1).sum()
    shell = sample_polygons(faces, int((area + b * h) / spacing**2), rng)
    floor = ground_around(
        (a, a), int(4 * a * a / spacing**2), lambda q: (np.abs(q) < (x, y)).all(axis=1), rng
    )
    slope, turn = np.radians(rng.uniform(5.0, 15.0)), rng.uniform(0.0, 2 * np.pi)
    c, d, e, f = np.cos(slope), np.sin(slope), np.cos(turn), np.sin(turn)
    R = np.array([[1, 0, 0], [0, c, -d], [0, d, c]]) @ np.array([[e, -f, 0], [f, e, 0], [0, 0, 1]])
    at, n = both(shell, floor)
    noise = float(rng.choice([0.003, 0.005, 0.01]))
    words = f"{a:.1f} m long, slope {np.degrees(slope):.0f} degrees"
    return scene((at @ R.T, n @ R.T), noise, (float(b * area_of(profile)),), words, rng)


KINDS: dict[str, Maker] = {
    "pile": pile,
    "sparse pile": sparse_pile,
    "two piles": two_piles,
    "box": box,
    "house": house,
    "boulder": boulder,
    "boulder from above": boulder_from_above,
    "log": log,
    "bowl": bowl,
    "pipe": tube,
    "foot unseen": upright,
    "leaning, foot unseen": leaning,
    "on wheels": on_wheels,
    "cup": cup,
    "car on a slope": car,
    "box on rough ground": box_on_rough_ground,
}


@dataclass(frozen=True)
class Answer:
    """status : sound, doubtful or refused · error, sigma : (b,) of each body over its volume ·
    say : reasons
    """

    status: str
    error: tuple[float, ...]
    sigma: tuple[float, ...]
    say: str

    @property
    def z(self) -> float:
        """Largest error in standard deviations."""
        both = zip(self.error, self.sigma, strict=True)
        return max((abs(e) / s for e, s in both), default=0.0)

    @property
    def silent(self) -> bool:
        """Whether it is wrong and says nothing."""
        return self.status == "sound" and self.z > 3.0


def ask(drawn: Scene, folder: Path, size: float = 1.0) -> Answer:
    """What the command line says of a scene, ``size`` times as large."""
    path, out, err = folder / "cloud.ply", io.StringIO(), io.StringIO()
    write_cloud(path, size * drawn.points)
    words = ["body", str(path), "-o", str(folder / "bodies.ply"), "--json"]
    words += [] if drawn.stands else ["--ground", "none"]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = ladar_volume(words)
    if code != 0:
        return Answer("refused", (), (), err.getvalue().strip().splitlines()[-1])
    facts = json.loads(out.getvalue())
    found = sorted(facts["bodies"], key=lambda b: -b["volume_m3"])
    truth = [size**3 * v for v in drawn.volume_m3]
    say = "; ".join(r["name"] for r in facts["verdict"]["reasons"])
    pairs = list(zip(found, truth, strict=False))
    if len(found) != len(truth):
        say = f"{len(found)} bodies for {len(truth)}: {say}"
        total = sum(truth)
        error = ((facts["volume_m3"] - total) / total,)
        sigma = ((facts["sigma_m3"] or np.inf) / total,)
        return Answer(facts["verdict"]["status"], error, sigma, say)
    error = tuple(b["volume_m3"] / v - 1.0 for b, v in pairs)
    sigma = tuple((b["sigma_m3"] or np.inf) / v for b, v in pairs)
    return Answer(facts["verdict"]["status"], error, sigma, say)


def answers(kind: str, seeds: range) -> Iterator[tuple[int, Scene, Answer]]:
    """Each seed's scene and answer."""
    number = list(KINDS).index(kind)
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            drawn = KINDS[kind](np.random.default_rng([seed, number, 21]))
            yield seed, drawn, ask(drawn, Path(folder))


def run(
    kinds: list[str] | None = None, seeds: range = range(SEEDS)
) -> dict[str, float | int | str]:
    """Counts by kind, and every answer on standard error."""
    figures: dict[str, float | int | str] = {}
    for kind in kinds or list(KINDS):
        all_of = []
        for seed, drawn, a in answers(kind, seeds):
            all_of.append(a)
            each = ", ".join(
                f"{100 * e:+.2f} ± {100 * s:.2f} %" for e, s in zip(a.error, a.sigma, strict=True)
            )
            mark = "SILENT " if a.silent else ""
            words = f"{mark}{a.status} {each} z {a.z:.1f} {a.say}"
            print(f"{kind} {seed}: {drawn.words}: {words}", file=sys.stderr, flush=True)
        given = [a for a in all_of if a.status != "refused"]
        within = sum(a.z <= 2.0 for a in given)
        sound = [a for a in given if a.status == "sound"]
        figures[f"{kind}: within 2 sigma, of answers"] = f"{within} of {len(given)}"
        figures[f"{kind}: sound, and of these within 2 sigma"] = (
            f"{len(sound)}, {sum(a.z <= 2.0 for a in sound)}"
        )
        figures[f"{kind}: doubtful, refused, silent"] = (
            f"{len(given) - len(sound)}, {len(all_of) - len(given)}, "
            f"{sum(a.silent for a in all_of)}"
        )
        errors = [abs(e) for a in given for e in a.error]
        if errors:
            figures[f"{kind}: median |error|, %"] = round(100 * float(np.median(errors)), 2)
    return figures


def main() -> None:
    """Run the kinds named, all by default."""
    words = sys.argv[1:]
    options = {"--seeds": SEEDS, "--first": 0}
    for name in options:
        if name in words:
            at = words.index(name)
            options[name] = int(words[at + 1])
            del words[at : at + 2]
    first = options["--first"]
    for name, value in run(words or None, range(first, first + options["--seeds"])).items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()

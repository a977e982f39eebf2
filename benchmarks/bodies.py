"""Volumes of bodies from noisy clouds: the filter, the mesh, the closing and the correction for
edges and curvature together.

Shapes with exact volumes, sampled uniformly by area, noise uniform within 5 cm either way along the
surface's normal, 100 outliers in the box of the points; those that stand nowhere in a random
orientation. 20 seeds. The goals stand beside.

``python -m benchmarks.bodies [NAME ...] [--seeds N]``
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.shapes import NOISE_M, OUTLIERS, frame_faces
from benchmarks.truth import F64, box_faces, rotation, sample_polygons
from ladar_volume.clouds.body_checks import check_bodies, uncertainty
from ladar_volume.clouds.body_points import filtered_points, ground_threshold
from ladar_volume.clouds.body_volume import Uncertain
from ladar_volume.clouds.cloud_bodies import CLEAR, CloudBodies, cloud_bodies
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.ground.objects import find_objects
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.body_parameters import BodyParameters, ObjectParameters
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.model.parameters import FilterParameters, GroundParameters

SEEDS = 20
Sample = tuple[F64, F64]


@dataclass(frozen=True)
class Case:
    """make : points and outward normals without noise · volume_m3 : exact · bias_pct, spread_pct :
    goals · euler : of the closed surface · stands : on a ground that is seen around it
    """

    make: Callable[[np.random.Generator], Sample]
    volume_m3: float
    bias_pct: float
    spread_pct: float
    euler: int = 2
    stands: bool = False


def joined(
    parts: list[tuple[float, Callable[[int, np.random.Generator], Sample]]],
    count: int,
    rng: np.random.Generator,
) -> Sample:
    """Samples of several surfaces, as many of each as its area's share."""
    area = np.array([a for a, _ in parts])
    numbers = rng.multinomial(count, area / area.sum())
    found = [make(int(n), rng) for n, (_, make) in zip(numbers, parts, strict=True)]
    return np.concatenate([p for p, _ in found]), np.concatenate([n for _, n in found])


def ball(count: int, rng: np.random.Generator, radius: float = 1.0, above: float = -1.0) -> Sample:
    """A sphere about the origin, or the part of it above a share of its radius: heights are uniform
    (Archimedes).
    """
    z, turn = rng.uniform(above, 1.0, count), rng.uniform(0.0, 2 * np.pi, count)
    s = np.sqrt(1.0 - z * z)
    n = np.stack([s * np.cos(turn), s * np.sin(turn), z], axis=1)
    return radius * n, n


def disc(
    count: int, rng: np.random.Generator, inner: float, outer: float, z: float, up: float
) -> Sample:
    """A level ring."""
    s, turn = np.sqrt(rng.uniform(inner**2, outer**2, count)), rng.uniform(0.0, 2 * np.pi, count)
    p = np.stack([s * np.cos(turn), s * np.sin(turn), np.full(count, z)], axis=1)
    return p, np.tile([0.0, 0.0, up], (count, 1))


def pipe(count: int, rng: np.random.Generator, radius: float, low: float, high: float) -> Sample:
    """An upright cylinder without its ends."""
    turn = rng.uniform(0.0, 2 * np.pi, count)
    n = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    return radius * n + np.outer(rng.uniform(low, high, count), [0.0, 0.0, 1.0]), n


def mushroom(
    rng: np.random.Generator, cap: float = 1.6, stem: float = 0.7, height: float = 1.6
) -> Sample:
    """Half a ball on a stem."""
    pi = np.pi
    return joined(
        [
            (2 * pi * cap**2, lambda n, g: ball(n, g, cap, 0.0)),
            (pi * (cap**2 - stem**2), lambda n, g: disc(n, g, stem, cap, 0.0, -1.0)),
            (2 * pi * stem * height, lambda n, g: pipe(n, g, stem, -height, 0.0)),
            (pi * stem**2, lambda n, g: disc(n, g, 0.0, stem, -height, -1.0)),
        ],
        8000,
        rng,
    )


def torus(rng: np.random.Generator, R: float = 1.5, r: float = 0.7, count: int = 6000) -> Sample:
    """A torus about z; points along the tube are kept by how much area they stand for."""
    b = rng.uniform(0.0, 2 * np.pi, 4 * count)
    b = b[rng.uniform(0.0, R + r, len(b)) < R + r * np.cos(b)][:count]
    a = rng.uniform(0.0, 2 * np.pi, len(b))
    n = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], axis=1)
    return r * n + R * np.stack([np.cos(a), np.sin(a), np.zeros(len(a))], axis=1), n


def prism(
    outline: list[tuple[float, float]], low: float, high: float, convex: list[list[int]]
) -> list[F64]:
    """Faces of an upright prism; ``convex`` are the parts of its outline, counter-clockwise."""
    p = np.array(outline)
    sides = [
        np.array([[*a, low], [*b, low], [*b, high], [*a, high]])
        for a, b in zip(p, np.roll(p, -1, axis=0), strict=True)
    ]
    ends = [np.array([[*p[i], high] for i in part]) for part in convex] + [
        np.array([[*p[i], low] for i in part[::-1]]) for part in convex
    ]
    return sides + ends


L_OUTLINE = [(0.0, 0.0), (1.2, 0.0), (1.2, 0.6), (0.6, 0.6), (0.6, 1.2), (0.0, 1.2)]
L_FACES = prism(L_OUTLINE, 0.0, 0.8, [[0, 1, 2, 3], [0, 3, 4, 5]])
CUBE_FACES = box_faces(np.full(3, -0.5), np.full(3, 0.5))
ON_GROUND = [
    *box_faces(np.array([-0.5, -0.5, 0.0]), np.array([0.5, 0.5, 1.0]))[1:],
    *frame_faces(0.5, 1.5),
]
#: A box of 1 x 1 x 0.8 m and one of 0.6 x 0.6 x 0.5 m at its side: what is seen of both.
BESIDE = box_faces(np.array([1.0, 0.2, 0.0]), np.array([1.6, 0.8, 0.5]))
TOUCHING = [
    *(f for f in box_faces(np.zeros(3), np.array([1.0, 1.0, 0.8])) if not (f[:, 0] == 1.0).all()),
    *(f for f in BESIDE if not (f[:, 0] == 1.0).all()),
    *(
        np.array([[1.0, y, z], [1.0, Y, z], [1.0, Y, Z], [1.0, y, Z]])
        for y, Y, z, Z in ((0.0, 0.2, 0.0, 0.8), (0.8, 1.0, 0.0, 0.8), (0.2, 0.8, 0.5, 0.8))
    ),
]

CASES: dict[str, Case] = {
    "cube on ground": Case(
        lambda g: sample_polygons(ON_GROUND, 5800, g), 1.0, 0.3, 0.5, stands=True
    ),
    "cube, six faces": Case(lambda g: sample_polygons(CUBE_FACES, 5800, g), 1.0, 0.2, 0.4),
    "sphere": Case(lambda g: ball(2200, g), 4 / 3 * np.pi, 0.15, 0.25),
    "L-block": Case(lambda g: sample_polygons(L_FACES, 6000, g), 0.8 * (1.44 - 0.36), 0.2, 0.4),
    "mushroom": Case(mushroom, 2 / 3 * np.pi * 1.6**3 + np.pi * 0.7**2 * 1.6, 0.2, 0.4),
    "torus": Case(torus, 2 * np.pi**2 * 1.5 * 0.49, 0.15, 0.25, euler=0),
    "two boxes that touch": Case(
        lambda g: sample_polygons(TOUCHING, 8000, g), 0.8 + 0.18, 0.2, 0.4
    ),
}


def cloud(case: Case, seed: int) -> F64:
    """The noisy points of a case."""
    rng = np.random.default_rng([seed, 11])
    at, normals = case.make(rng)
    points = at + rng.uniform(-NOISE_M, NOISE_M, (len(at), 1)) * normals
    points = np.concatenate(
        [points, rng.uniform(points.min(axis=0), points.max(axis=0), (OUTLIERS, 3))]
    )
    if not case.stands:
        points = points @ rotation(rng).T + rng.uniform(-5.0, 5.0, 3)
    return points[rng.permutation(len(points))]


def measure(points: F64, stands: bool) -> tuple[CloudBodies, Uncertain]:
    """Filter, find, mesh, close, sum: nothing is known but whether there is a ground."""
    of = filtered_points(filter_cloud(points, FilterParameters(), auto=True))
    ground, label = None, np.zeros(len(of.r), np.int64)
    if stands:
        variance = np.zeros(len(of.r)) if of.sigma is None else of.sigma**2
        ground = fit_ground(of.r, variance, GroundParameters(), ground_threshold(of))
        label = find_objects(
            of.r, [ground], ObjectParameters(min_height_m=CLEAR * of.noise_m)
        ).label
    found = cloud_bodies(of.r, of.normal, of.curved, label, ground)
    if found.failed:
        raise SystemExit(f"{len(found.failed)} bodies failed: {found.failed[0].reason}")
    found, checked = check_bodies(found, of, points, BodyParameters())
    uncertain = uncertainty(found, checked, of, points)
    if uncertain is None:
        raise SystemExit("a filtered cloud tells its noise")
    return found, uncertain


def one(case: Case, seed: int) -> dict[str, float]:
    """The figures of one cloud, volumes in percent of the true one."""
    found, uncertain = measure(cloud(case, seed), case.stands)
    body = found.bodies[0]
    order, start, _ = edge_table(body.skin.triangles)
    uses = np.diff(start)
    skin = body.skin
    total = sum(b.volume_m3 for b in found.bodies)
    plain = sum(b.uncorrected_m3 for b in found.bodies)
    return {
        "error": 100 * (total / case.volume_m3 - 1),
        "uncorrected": 100 * (plain / case.volume_m3 - 1),
        "sigma": 100 * float(np.sqrt(uncertain.C_m6.sum())) / case.volume_m3,
        "bodies": len(found.bodies),
        "non_manifold": float(np.count_nonzero(uses > 2)),
        "watertight": float((uses == 2).all()),
        "euler": float(len(np.unique(skin.triangles)) - len(uses) + len(skin.triangles)),
        "crossing": body.crossing_pairs,
        "closed": 100 * body.closed_m3 / case.volume_m3,
        "closures": len(body.closures),
        "filtered": len(order) / 3,
    }


def run(names: list[str] | None = None, seeds: int = SEEDS) -> dict[str, float | int | str]:
    """Every case; the figures of the table."""
    out: dict[str, float | int | str] = {"seeds": seeds}
    for name in names or list(CASES):
        case = CASES[name]
        rows, refused = [], 0
        for seed in range(seeds):
            try:
                rows.append(one(case, seed))
            except LadarVolumeError:
                refused += 1
        if len(rows) < 2:
            out[name] = f"refused {refused} of {seeds}"
            continue
        table = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        error = table["error"]
        words = (
            f"bias {error.mean():+.3f} % (goal ±{case.bias_pct}), spread "
            f"{error.std(ddof=1):.3f} % (goal {case.spread_pct}), "
            f"mean sigma {table['sigma'].mean():.3f} %, uncorrected "
            f"{table['uncorrected'].mean():+.3f} %, "
            f"non-manifold edges {int(table['non_manifold'].sum())}, watertight "
            f"{int(table['watertight'].sum())}, "
            f"refused {refused}, V - E + F = {case.euler} in "
            f"{int((table['euler'] == case.euler).sum())}, "
            f"crossing pairs {table['crossing'].mean():.0f}"
        )
        out[name] = words
    return out


if __name__ == "__main__":
    words = sys.argv[1:]
    count = int(words[words.index("--seeds") + 1]) if "--seeds" in words else SEEDS
    wanted = [w for w in words if w in CASES]
    for wanted_name in wanted or list(CASES):
        print(f"{wanted_name}: {run([wanted_name], count)[wanted_name]}", flush=True)

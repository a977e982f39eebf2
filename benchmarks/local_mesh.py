"""Meshing in any direction: filtered spheres and cubes of 20 seeds, and 300,000 points of the
square.

A mesh is whole where it is watertight, in one part, of Euler characteristic 2. Points of the square
are without noise. Compilation is done before.
"""

from __future__ import annotations

import time
from unittest.mock import patch

import numba
import numpy as np

from benchmarks import shapes, square
from benchmarks.truth import F64
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.mesh.edge_completion import sharpen
from ladar_volume.mesh.linear_mesh import LinearMesh, linear_mesh
from ladar_volume.mesh.local_mesh import BOX, LocalMesh, mesh_cloud
from ladar_volume.mesh.topology import orient
from ladar_volume.model.body_parameters import LocalMeshParameters
from ladar_volume.model.choices import REPAIRS
from ladar_volume.model.cloud_filter_parameters import FilterParameters

SEEDS, COUNT = range(20), 300_000
TRUE = {"sphere": 4 / 3 * np.pi, "cube": 1.0}


def volume(mesh: LocalMesh | LinearMesh) -> float:
    """Sum of signed tetrahedra, m³, also of a mesh that overlaps."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def square_points(count: int) -> F64:
    """That many points of the square's surfaces, in random order."""
    with patch.object(square, "NOISE_M", 0.0):
        whole = square.square(round(1.2 * count))
    points = whole.points[whole.label < square.CROWN]
    return points[np.random.default_rng(0).permutation(len(points))[:count]]


def body(name: str) -> dict[str, float | int | str]:
    """Whole meshes and deviation of the volume of one shape, over the seeds."""
    off: dict[str, list[float]] = {"through the points": [], "edges completed": []}
    whole = over = 0.0
    for seed in SEEDS:
        result = filter_cloud(getattr(shapes, name)(seed).points, FilterParameters(), auto=True)
        mesh = mesh_cloud(result.r, result.normal)
        sharp = sharpen(linear_mesh(mesh.vertices, mesh.triangles, mesh.normals))[0]
        off["through the points"].append(100 * (volume(mesh) / TRUE[name] - 1))
        off["edges completed"].append(100 * (volume(sharp) / TRUE[name] - 1))
        one = orient(sharp.vertices, sharp.triangles)
        whole += one.euler == 2 and not len(one.boundary) and one.part.max() == 0
        over += 100 * mesh.report["over_full_before"] / mesh.report["edges_before"] / len(SEEDS)
    out: dict[str, float | int | str] = {
        f"{name}, whole meshes of {len(SEEDS)}": int(whole),
        f"{name}, over-full edges before, %": over,
    }
    for key, values in off.items():
        out[f"{name}, {key}, volume, %"] = f"{np.mean(values):+.3f} ± {np.std(values, ddof=1):.3f}"
    return out


def repairs() -> dict[str, float | int | str]:
    """Deviation of the volume of a filtered cube by the published method, for each repair, %."""
    result = filter_cloud(shapes.cube(0).points, FilterParameters(), auto=True)
    out: dict[str, float | int | str] = {}
    for repair in REPAIRS:
        mesh = mesh_cloud(
            result.r,
            result.normal,
            LocalMeshParameters(BOX.radius_m, method="published", repair=repair),
        )
        out[f"cube as published, {repair}, volume, %"] = 100 * (volume(mesh) - 1)
    return out


def run() -> dict[str, float | int | str]:
    """All figures; times are the best of three."""
    points = square_points(COUNT)
    mesh_cloud(points[::10])
    wall, cpu = [], []
    for _ in range(3):
        start, used = time.perf_counter(), time.process_time()
        mesh = mesh_cloud(points)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - used)
    done = orient(mesh.vertices, mesh.triangles)
    return {
        "threads": numba.get_num_threads(),
        f"square, {COUNT} points, s": min(wall),
        "square, processor time, s": min(cpu),
        "square, triangles": len(mesh.triangles),
        "square, over-full edges before, %": 100
        * mesh.report["over_full_before"]
        / mesh.report["edges_before"],
        "square, rims": len(mesh.rims),
        "square, Euler characteristic": done.euler,
        **body("sphere"),
        **body("cube"),
        **repairs(),
    }

"""Other filters behind the interface of the cloud filter: points and parameters in, kept points
with their input indices out.

PCL through its command-line tools (Debian's ``pcl-tools``), Open3D and MeshLab in this process.
What is not installed raises ``Missing``.
"""

from __future__ import annotations

import importlib
import resource
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.shapes import Result
from benchmarks.truth import F64, I64, Mask


class Missing(RuntimeError):
    """A peer is not installed here."""


@dataclass(frozen=True)
class Kept:
    """What a peer returns, in the terms of the cloud filter's result. ``spent``: wall and CPU
    seconds of its own where files are written for it and input indices are found afterwards, which
    is not its work.
    """

    r: F64
    index: I64
    outliers: I64
    spent: tuple[float, float] | None = None


def by_mask(points: F64, keep: Mask) -> Kept:
    """Points kept where they are."""
    return Kept(points[keep], np.flatnonzero(keep), np.flatnonzero(~keep))


def module(name: str) -> Any:
    """An optional package."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise Missing(f"{name} is not installed") from error


def tool(*words: str) -> tuple[float, float]:
    """Run a command-line tool; wall and CPU seconds."""
    if shutil.which(words[0]) is None:
        raise Missing(f"{words[0]} is not installed")
    wall, cpu = time.perf_counter(), cpu_seconds()
    subprocess.run(words, check=True, capture_output=True)
    return time.perf_counter() - wall, cpu_seconds() - cpu


def write_pcd(path: Path, points: F64) -> None:
    """A binary PCD of float32 x, y, z."""
    n = len(points)
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    head += f"WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA binary\n"
    path.write_bytes(head.encode() + np.ascontiguousarray(points, dtype="<f4").tobytes())


def read_pcd(path: Path) -> F64:
    """Points (n, 3) of any PCD, the compressed ones of PCL's tools among them."""
    out: F64 = np.asarray(module("open3d").io.read_point_cloud(str(path)).points)
    return out


def same_rows(inner: F64, outer: F64) -> I64:
    """For rows copied in order out of ``outer`` as float32: which they are."""
    at, found = 0, np.empty(len(inner), np.int64)
    small, large = inner.astype(np.float32), outer.astype(np.float32)
    equal = large.view([("", np.float32)] * 3).ravel()
    wanted = small.view([("", np.float32)] * 3).ravel()
    for i, row in enumerate(wanted):
        while equal[at] != row:
            at += 1
        found[i] = at
        at += 1
    return found


def pcl_outliers(
    points: F64, folder: Path, mean_k: int = 20, sigmas: float = 2.0
) -> tuple[I64, tuple[float, float]]:
    """Indices PCL's statistical outlier removal keeps; seconds."""
    write_pcd(folder / "in.pcd", points)
    options = ["-method", "statistical", "-mean_k", str(mean_k), "-std_dev_mul", str(sigmas)]
    spent = tool("pcl_outlier_removal", str(folder / "in.pcd"), str(folder / "kept.pcd"), *options)
    return same_rows(read_pcd(folder / "kept.pcd"), points), spent


def pcl_mls(points: F64, radius: float, order: int = 2, clean: bool = False) -> Kept:
    """PCL's moving least squares, alone or after its outlier removal. Points with fewer than three
    neighbours are dropped by it.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        index, before = (
            pcl_outliers(points, folder) if clean else (np.arange(len(points)), (0.0, 0.0))
        )
        write_pcd(folder / "in.pcd", points[index])
        options = [
            "-radius",
            str(radius),
            "-sqr_gauss_param",
            str(radius**2),
            "-polynomial_order",
            str(order),
        ]
        wall, cpu = tool(
            "pcl_mls_smoothing", str(folder / "in.pcd"), str(folder / "out.pcd"), *options
        )
        r = read_pcd(folder / "out.pcd")
    if len(r) < len(index):
        small = points[index].astype(np.float32).astype(np.float64)
        third = np.asarray(
            cKDTree(small).query(small, k=[3], distance_upper_bound=radius)[0]
        ).ravel()
        index = index[np.isfinite(third)]
    if len(r) != len(index):
        raise RuntimeError(f"PCL returned {len(r)} points, {len(index)} were expected")
    sound = np.isfinite(r).all(axis=1)
    removed = np.setdiff1d(np.arange(len(points)), index[sound])
    return Kept(r[sound], index[sound], removed, (before[0] + wall, before[1] + cpu))


def open3d_outliers(points: F64, neighbours: int = 20, sigmas: float = 2.0) -> Kept:
    """Open3D's statistical outlier removal: nothing is smoothed."""
    o3d = module("open3d")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    index = np.asarray(
        cloud.remove_statistical_outlier(nb_neighbors=neighbours, std_ratio=sigmas)[1]
    )
    keep = np.zeros(len(points), bool)
    keep[index] = True
    return by_mask(points, keep)


def meshlab_outliers(points: F64, probability: float = 0.8, neighbours: int = 32) -> Kept:
    """MeshLab's selection by local outlier probability. Its projections onto a moving least squares
    surface (RIMLS, APSS) end the process on a cloud without triangles (2025.07), so there is no
    smoothing to compare.
    """
    meshlab = module("pymeshlab")
    meshes = meshlab.MeshSet()
    meshes.add_mesh(meshlab.Mesh(vertex_matrix=points))
    meshes.compute_selection_point_cloud_outliers(propthreshold=probability, knearest=neighbours)
    return by_mask(points, ~np.asarray(meshes.current_mesh().vertex_selection_array()))


def timed(
    method: Callable[[F64], Result], points: F64, times: int = 3
) -> tuple[float, float, Result]:
    """Median wall and CPU seconds, child processes included, and the last answer."""
    spent = []
    for _ in range(times):
        wall, cpu = time.perf_counter(), cpu_seconds()
        result = method(points)
        whole = (time.perf_counter() - wall, cpu_seconds() - cpu)
        spent.append(getattr(result, "spent", None) or whole)
    return (
        statistics.median(wall for wall, _ in spent),
        statistics.median(cpu for _, cpu in spent),
        result,
    )


def cpu_seconds() -> float:
    """CPU time of this process, all its threads, and the children that ended."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in both)


def startup_s(name: str = "pcl_mls_smoothing") -> tuple[float, float]:
    """Wall and CPU seconds a tool needs to load its libraries and say that a file is not there; the
    least of five.
    """
    if shutil.which(name) is None:
        return 0.0, 0.0
    spent = []
    for _ in range(5):
        wall, cpu = time.perf_counter(), cpu_seconds()
        subprocess.run([name, "none.pcd", "none.pcd"], check=False, capture_output=True)
        spent.append((time.perf_counter() - wall, cpu_seconds() - cpu))
    return min(wall for wall, _ in spent), min(cpu for _, cpu in spent)

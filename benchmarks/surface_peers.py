"""The Delaunay kernel beside CGAL, Triangle, startinpy and Qhull, and the adaptive insertion, on
one core and in one run.

``python -m benchmarks.surface_peers [N]`` (default 1,000,000 points). A peer that is not installed
is left out: CGAL needs Debian's libcgal-dev and g++, Triangle and startinpy the wheels of
``benchmarks/requirements.txt``. CPU seconds, medians of three; memory is the growth of the peak
resident size in a process of its own, input included.
"""

from __future__ import annotations

import importlib.util
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ladar_volume.tin.adaptive import adaptive_tin
from ladar_volume.tin.delaunay import Triangulation, triangulate
from ladar_volume.tin.insertion_order import hilbert_order

Points = npt.NDArray[np.float64]

CGAL = r"""
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Delaunay_triangulation_2.h>
#include <ctime>
#include <fstream>
#include <iostream>
#include <vector>
typedef CGAL::Exact_predicates_inexact_constructions_kernel K;
int main(int, char** v) {
  std::ifstream f(v[1], std::ios::binary);
  std::vector<K::Point_2> p;
  double c[2];
  while (f.read((char*)c, 16)) p.emplace_back(c[0], c[1]);
  for (int i = 0; i < 3; i++) {
    std::clock_t began = std::clock();
    CGAL::Delaunay_triangulation_2<K> t;
    t.insert(p.begin(), p.end());
    std::cout << double(std::clock() - began) / CLOCKS_PER_SEC << " "
              << t.number_of_faces() << "\n";
  }
}
"""


def clouds(n: int) -> dict[str, Points]:
    """Random, LiDAR-like (rings of a scanner on the move, rounded to millimetres) and grid
    footprints.
    """
    rng = np.random.default_rng(5)
    a = np.arange(n) * (2.0 * np.pi / 1800.0) / 16.0
    ring = 12.0 / np.tan(np.radians(4.0 + 3.0 * (np.arange(n) % 16)))
    track = np.arange(n) * (400.0 / n)
    lidar = np.column_stack([track + ring * np.cos(a), ring * np.sin(a)]) + rng.normal(
        0.0, 0.02, (n, 2)
    )
    k = int(np.sqrt(n))
    grid = np.stack(np.meshgrid(np.arange(k), np.arange(k)), axis=-1).reshape(-1, 2).astype(float)
    return {
        "random": rng.random((n, 2)) * 1000.0,
        "LiDAR-like": np.round(lidar, 3),
        "grid": grid,
        "grid of tenths": grid * 0.1,
    }


def cpu_s(action: Callable[[], object], times: int = 3) -> float:
    """Median CPU seconds."""
    out = []
    for _ in range(times):
        began = time.process_time()
        action()
        out.append(time.process_time() - began)
    return statistics.median(out)


def cgal_s(xy: Points) -> tuple[float, int] | None:
    """CGAL's median and its number of triangles, None where it cannot be built."""
    if shutil.which("g++") is None or not Path("/usr/include/CGAL").exists():
        return None
    folder = Path(tempfile.gettempdir()) / "ladar_volume_cgal"
    folder.mkdir(exist_ok=True)
    if not (folder / "cgal").exists():
        (folder / "cgal.cpp").write_text(CGAL)
        subprocess.run(
            [
                "g++",
                "-O3",
                "-DNDEBUG",
                "-march=native",
                "-o",
                "cgal",
                "cgal.cpp",
                "-lgmp",
                "-lmpfr",
            ],
            cwd=folder,
            check=True,
        )
    xy.tofile(folder / "points.bin")
    lines = subprocess.run(
        [folder / "cgal", folder / "points.bin"], check=True, capture_output=True, text=True
    ).stdout.split("\n")
    return statistics.median(float(line.split()[0]) for line in lines[:3]), int(lines[0].split()[1])


def other_peers(xy: Points) -> dict[str, tuple[float, int]]:
    """CPU seconds of the Python peers that are installed, and how many triangles they find."""
    from scipy.spatial import Delaunay

    out = {"Qhull": timed(lambda: len(Delaunay(xy).simplices))}
    if importlib.util.find_spec("triangle"):
        import triangle

        out["Triangle"] = timed(lambda: len(triangle.delaunay(xy)))
    if importlib.util.find_spec("startinpy"):
        import startinpy

        def run() -> int:
            dt = startinpy.DT()
            dt.snap_tolerance = 1e-9
            dt.insert(
                np.column_stack([xy, np.zeros(len(xy))])[hilbert_order(xy)]
            )  # as given it walks across the whole map every time
            return int(dt.number_of_triangles())

        out["startinpy, sorted"] = timed(run)
    return out


def timed(action: Callable[[], int]) -> tuple[float, int]:
    """CPU seconds of one run, and what it returns."""
    began = time.process_time()
    value = action()
    return time.process_time() - began, value


def same_triangles(xy: Points, own: Triangulation) -> bool:
    """Whether Qhull finds the same triangles."""
    from scipy.spatial import Delaunay

    theirs = np.sort(Delaunay(xy).simplices, axis=1)
    ours = np.sort(own.triangles, axis=1)
    return np.array_equal(theirs[np.lexsort(theirs.T)], ours[np.lexsort(ours.T)])


def bytes_per_point(n: int) -> float:
    """Growth of the peak resident size from before the points were made to after their
    triangulation, over n.
    """
    code = (
        "import re, numpy as np; from ladar_volume.tin.delaunay import triangulate; r = "
        "np.random.default_rng(0)\n"
        # the peak that getrusage gives is inherited from the parent; this one begins with the
        # program
        "peak = lambda: 1024 * int(re.search(r'VmHWM:\\s+(\\d+)', "
        "open('/proc/self/status').read())[1])\n"
        f"triangulate(r.random((1000, 2))); before = peak(); out = triangulate(r.random(({n}, "
        f"2))); print((peak() - before) / {n})"
    )
    return float(
        subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        ).stdout
    )


def hills(n: int) -> Points:
    """A surface with two wavelengths and 3 cm of noise over random footprints on a square
    kilometre.
    """
    rng = np.random.default_rng(0)
    xy = rng.random((n, 2)) * 1000.0
    return np.column_stack(
        [xy, 20.0 * np.sin(xy[:, 0] / 90.0) * np.cos(xy[:, 1] / 70.0) + rng.normal(0.0, 0.03, n)]
    )


def run(n: int = 1_000_000) -> dict[str, float | int | str]:
    """Compilation done before."""
    rng = np.random.default_rng(1)
    adaptive_tin(rng.random((1000, 3)))
    figures: dict[str, float | int | str] = {"points": n}
    for name, xy in clouds(n).items():
        out = triangulate(xy)
        own = cpu_s(lambda xy=xy: triangulate(xy))  # type: ignore[misc]
        figures[f"{name}: own / CPU s"] = own
        figures[f"{name}: million points / s"] = len(xy) / own / 1e6
        figures[f"{name}: exact orientations, exact incircles"] = (
            f"{out.exact_orientations}, {out.exact_incircles}"
        )
        cgal = cgal_s(xy)
        if cgal is not None:
            figures[f"{name}: CGAL / CPU s"] = cgal[0]
            figures[f"{name}: own speed / CGAL's"] = cgal[0] / own
            figures[f"{name}: triangles, own and CGAL"] = f"{len(out.triangles)}, {cgal[1]}"
    small = clouds(200_000)["random"]
    own = cpu_s(lambda: triangulate(small))
    figures["200,000 random: own / CPU s"] = own
    for name, (seconds, triangles) in other_peers(small).items():
        figures[f"200,000 random: {name} / CPU s"] = seconds
        figures[f"200,000 random: {name}'s time / own"] = seconds / own
        figures[f"200,000 random: triangles, own and {name}"] = (
            f"{len(triangulate(small).triangles)}, {triangles}"
        )
    figures["200,000 random: same triangles as Qhull"] = str(
        same_triangles(small, triangulate(small))
    )
    figures["bytes per point, input included"] = bytes_per_point(n)
    for part in (n // 10, n):
        points = hills(part)
        seconds = cpu_s(lambda points=points: adaptive_tin(points), 3 if part < n else 1)
        figures[f"a third of {part} points, greedily / CPU s"] = seconds
        figures[f"a third of {part} points: CPU ns / (n log2 n)"] = (
            1e9 * seconds / (part * np.log2(part))
        )
    figures["peak of this process / MB"] = (
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    )
    return figures


if __name__ == "__main__":
    for key, value in run(int(float(sys.argv[1])) if len(sys.argv) > 1 else 1_000_000).items():
        print(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")

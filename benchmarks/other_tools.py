"""The same piles in this tool and in others: error, CPU time, and whether sigma is told.

A cone of 268.08 m³ in a square of 24 m, 20 points per m², 1.5 cm of noise: on level ground, on
ground that tilts by 5 %, and with 0.3 % of strays. This tool gets the file alone. The others get,
besides, an outline that somebody drew 0.6 m outside the toe, and as the base what their users take.

- CloudCompare: `-VOLUME`, cells of 0.5 m (it leaves out empty ones), above the mean height along
  the outline.
- GRASS: `r.in.xyz` (mean) into cells of 0.5 m, `r.volume` of the heights above the same level.
- PyVista: `delaunay_2d` of the points, its prisms above the same level.
- WebODM's formula, as its documentation tells it: a raster of heights, cells of 0.2 m, the sum of
  the heights above a base through the heights along the outline (plane).

    python -m benchmarks.other_tools          # Debian: apt install cloudcompare grass-core
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from ladar_volume.cli.main import main as ladar_volume

RADIUS_M, HEIGHT_M, HALF_M, NOISE_M, DENSITY, MARGIN_M = 8.0, 4.0, 12.0, 0.015, 20.0, 0.6
TRUE_M3 = np.pi * RADIUS_M**2 * HEIGHT_M / 3.0
KINDS = {"level": (0.0, 0.0), "tilted": (0.05, 0.0), "strays": (0.05, 0.003)}
SEEDS = 5


def cloud(kind: str, seed: int) -> np.ndarray:
    """Points (n, 3) of one site."""
    tilt, share = KINDS[kind]
    rng = np.random.default_rng([seed, *map(ord, kind)])
    xy = rng.uniform(-HALF_M, HALF_M, (int(DENSITY * (2 * HALF_M) ** 2), 2))
    pile = HEIGHT_M * np.clip(1.0 - np.hypot(*xy.T) / RADIUS_M, 0.0, None)
    z = 100.0 + tilt * xy[:, 0] + pile + rng.normal(0.0, NOISE_M, len(xy))
    off = rng.random(len(xy)) < share
    z[off] += rng.uniform(1.0, 6.0, int(off.sum()))
    return np.c_[xy, z]


def ring() -> np.ndarray:
    """The outline (40, 2)."""
    a = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    return (RADIUS_M + MARGIN_M) * np.c_[np.cos(a), np.sin(a)]


def inside(xy: np.ndarray) -> np.ndarray:
    """Which points are within the outline."""
    from matplotlib.path import Path as Polygon

    return np.asarray(Polygon(ring()).contains_points(xy))


def along(p: np.ndarray) -> np.ndarray:
    """Places (40, 3) of the outline with the heights of the surface there."""
    return np.c_[ring(), LinearNDInterpolator(p[:, :2], p[:, 2])(ring())]


def of_this_tool(p: np.ndarray, folder: Path) -> tuple[float, str]:
    """``volume FILE --base ground``."""
    np.savetxt(folder / "own.xyz", p, fmt="%.4f")
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        ladar_volume(["volume", str(folder / "own.xyz"), "--base", "ground", "--json"])
    facts = json.loads(out.getvalue())
    return facts["net_m3"], f"± {facts['sigma_m3']:.2f}, {facts['verdict']['status']}"


def of_cloudcompare(p: np.ndarray, folder: Path) -> tuple[float, str]:
    """The 2.5D volume of the command line."""
    np.savetxt(folder / "in.asc", p[inside(p[:, :2])], fmt="%.4f")
    program = shutil.which("cloudcompare") or shutil.which("CloudCompare") or "CloudCompare"
    level = along(p)[:, 2].mean()
    words = [program, "-SILENT", "-AUTO_SAVE", "OFF", "-O", "in.asc"]
    words += ["-VOLUME", "-GRID_STEP", "0.5", "-CONST_HEIGHT", f"{level:.6f}"]
    environment = os.environ | {"QT_QPA_PLATFORM": "offscreen", "HOME": str(folder)}
    subprocess.run(words, cwd=folder, env=environment, check=True, capture_output=True, timeout=300)
    (report,) = folder.glob("*olume*.txt")
    return abs(float(re.findall(r"Volume: *(-?[\d.]+)", report.read_text())[0])), "none"


def of_grass(p: np.ndarray, folder: Path) -> tuple[float, str]:
    """Cells of mean heights and their sum."""
    chosen = p[inside(p[:, :2])]
    chosen[:, 2] -= along(p)[:, 2].mean()
    np.savetxt(folder / "in.txt", chosen, fmt="%.4f", delimiter="|")
    script = (
        "g.region n=9.5 s=-9.5 e=9.5 w=-9.5 res=0.5 && "
        f"r.in.xyz input={folder}/in.txt output=h method=mean --q && "
        "r.mapcalc 'c = if(isnull(h), null(), 1)' --q && r.volume -f input=h clump=c"
    )
    words = ["grass", "-c", "XY", str(folder / "place"), "--exec", "sh", "-c", script]
    environment = os.environ | {"HOME": str(folder)}
    done = subprocess.run(
        words, env=environment, check=True, capture_output=True, text=True, timeout=300
    )
    last = [line for line in done.stdout.splitlines() if re.match(r"^[\d:.|-]+$", line)][-1]
    return float(last.split("|" if "|" in last else ":")[-1]), "none"


def of_pyvista(p: np.ndarray, folder: Path) -> tuple[float, str]:
    """Prisms of a Delaunay triangulation."""
    import pyvista

    chosen = p[inside(p[:, :2])]
    mesh = pyvista.PolyData(chosen).delaunay_2d()
    flat = mesh.copy()
    flat.points[:, 2] = 0.0
    area = flat.compute_cell_sizes()["Area"]
    faces = mesh.faces.reshape(-1, 4)[:, 1:]
    height = mesh.points[faces, 2].mean(axis=1) - along(p)[:, 2].mean()
    return float((area * height).sum()), "none"


def of_webodm(p: np.ndarray, folder: Path) -> tuple[float, str]:
    """A raster of heights above the plane through the outline."""
    edge, cell = along(p), 0.2
    c, *_ = np.linalg.lstsq(np.c_[np.ones(len(edge)), edge[:, :2]], edge[:, 2], rcond=None)
    at = np.arange(-10.0, 10.0, cell) + 0.5 * cell
    xy = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    xy = xy[inside(xy)]
    height = LinearNDInterpolator(p[:, :2], p[:, 2])(xy) - np.c_[np.ones(len(xy)), xy] @ c
    return float(np.nansum(height) * cell**2), "none"


TOOLS: dict[str, Callable[[np.ndarray, Path], tuple[float, str]]] = {
    "ladar_volume": of_this_tool,
    "CloudCompare": of_cloudcompare,
    "GRASS": of_grass,
    "PyVista": of_pyvista,
    "WebODM's formula": of_webodm,
}


def cpu_s() -> float:
    """CPU time of this process and those that it waited for, s."""
    both = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_utime + u.ru_stime for u in both)


def row(tool: str, kind: str) -> str:
    """One line of the table."""
    errors, says, began = [], "", cpu_s()
    for seed in range(SEEDS):
        with tempfile.TemporaryDirectory() as folder:
            try:
                found, says = TOOLS[tool](cloud(kind, seed), Path(folder))
            except (OSError, ImportError, subprocess.SubprocessError, ValueError) as error:
                return f"| {tool} | {kind} | not run: {str(error)[:60]} | | | |"
        errors.append(found - TRUE_M3)
    e = np.array(errors)
    took = (cpu_s() - began) / SEEDS
    return f"| {tool} | {kind} | {e.mean():+.2f} | {e.std(ddof=1):.2f} | {says} | {took:.1f} |"


def main() -> None:
    """Print the table."""
    print(f"true volume {TRUE_M3:.2f} m³, {SEEDS} clouds each")
    print("| tool | site | mean error / m³ | spread / m³ | sigma, verdict (last) | CPU s |")
    print("|---|---|---|---|---|---|")
    cloud_own = cloud("level", 99)
    with tempfile.TemporaryDirectory() as folder:
        of_this_tool(cloud_own, Path(folder))  # kernels are loaded once
    for kind in KINDS:
        for tool in TOOLS:
            print(row(tool, kind), flush=True)


if __name__ == "__main__":
    main()

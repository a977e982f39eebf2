"""A real box of balls, scanned from above with 25 and with 100 of them: how much larger the bulk
is, in two ways of this package.

Data: H-Ekana/Molycop-Bin-Volume-Calculation (Unlicense), in ``../shared/data/ball_box`` or where
LADAR_SHARED_DATA says. No volume is published; the yardstick is the highest point of each 5 mm
cell, summed above the floor at -2.094 m: 15.24 - 4.61 L. It defines the bulk as what lies under the
highest points of 5 mm cells; so do both ways here.
"""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np

from benchmarks.truth import F64, I64
from ladar_volume.change.spherical_tin import build_spherical, unit_directions
from ladar_volume.clouds.cloud_surface import CloudSurface, cloud_surface
from ladar_volume.clouds.cloud_volume import difference_of_footprints
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.mesh.tetrahedra import closed_volume
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.surface_parameters import SurfaceParameters

FOLDER = (
    Path(os.environ.get("LADAR_SHARED_DATA", Path(__file__).parents[2] / "shared" / "data"))
    / "ball_box"
)
FILES = {
    count: FOLDER / f"Cloud_Compare_Files_Just_Balls_Just_Balls_{count}_deep.pcd"
    for count in (25, 100)
}
FLOOR_M, CELL_M, YARDSTICK_L = -2.094, 0.005, 15.24 - 4.61
#: Noise of a return, m: the scanner's ranges (a quadric's residual would count the balls as noise).
SIGMA_M = 0.003
#: How far the rim of the scan may be from the wall of the box, m: half the spacing of the points.
RIM_M = 0.0008


def there() -> bool:
    """Whether the recordings are."""
    return all(path.is_file() for path in FILES.values())


def clouds() -> tuple[F64, F64]:
    """Points (n, 3) m with 100 and with 25 balls; the scanner is the origin."""
    return read_cloud(FILES[100], columns=False).r, read_cloud(FILES[25], columns=False).r


def highest(points: F64, cell_m: float = CELL_M, phase: float = 0.0) -> I64:
    """Indices of the highest point in each cell in plan; ``phase`` moves the cells by a part of
    their size.
    """
    cell = np.floor(points[:, :2] / cell_m + phase)
    order = np.lexsort((-points[:, 2], cell[:, 1], cell[:, 0]))
    first = np.append(True, (np.diff(cell[order], axis=0) != 0).any(axis=1))
    return np.sort(order[first]).astype(np.int64)


def by_prismoids(many: F64, few: F64) -> tuple[float, float]:
    """Difference and its sigma from noise, m³: TINs in plan, each above the floor over its own
    footprint.
    """
    level = dataclasses.replace(Parameters().volume, base="level", level_m=FLOOR_M, outline="all")
    options = SurfaceParameters(ratio=1.0, relevant="all")
    made: list[CloudSurface] = [cloud_surface(p, options, SIGMA_M, "given") for p in (many, few)]
    found = difference_of_footprints(
        made[0], made[1], dataclasses.replace(Parameters(), volume=level)
    )[0]
    return found.net_m3, found.sigma_m3


def by_tetrahedra(points: F64) -> tuple[float, float, float, float]:
    """Volume, its sigma from noise along the beam, the largest change over nine poles, m³, and the
    length of the rim, m: triangulated about the scanner, every vertex with its foot on the floor,
    walls along the rim, signed tetrahedra to a pole.
    """
    tin = build_spherical(points, np.zeros(3)).tin
    v, t, n = tin.vertices, tin.triangles, len(tin.vertices)
    rim_t, corner = np.nonzero(tin.neighbours < 0)
    a, b = t[rim_t, (corner + 1) % 3], t[rim_t, (corner + 2) % 3]
    walls = np.concatenate([np.stack([b, a, n + a], axis=1), np.stack([b, n + a, n + b], axis=1)])
    feet = v * [1.0, 1.0, 0.0] + [0.0, 0.0, FLOOR_M]
    body = closed_volume(
        np.concatenate([v, feet]),
        np.concatenate([t, n + t[:, [0, 2, 1]], walls]).astype(np.int32),
        np.zeros(3),
        allow_crossings=True,
    )
    gradient = body.gradient[:n] + body.gradient[n:] * [
        1.0,
        1.0,
        0.0,
    ]  # a foot moves with its point, on the floor
    along = (gradient * unit_directions(v, np.zeros(3))[0]).sum(axis=1)
    rim = float(np.linalg.norm((v[a] - v[b])[:, :2], axis=1).sum())
    return body.volume_m3, SIGMA_M * float(np.linalg.norm(along)), body.pole_spread_m3, rim


def run() -> dict[str, float | int | str]:
    """Differences in litres with their sigmas: noise, the choice of cells, and where the box's wall
    is.
    """
    if not there():
        return {"data": f"not in {FOLDER}"}
    many, few = clouds()
    out: dict[str, float | int | str] = {"yardstick, L": YARDSTICK_L}
    plan, solid = [], []
    for cell in (0.004, 0.005, 0.006):
        for phase in (0.0, 0.5):
            a, b = many[highest(many, cell, phase)], few[highest(few, cell, phase)]
            (one, sigma_one, pole, rim), (two, sigma_two, _, _) = by_tetrahedra(a), by_tetrahedra(b)
            plan.append(by_prismoids(a, b))
            solid.append((one - two, float(np.hypot(sigma_one, sigma_two)), pole, one, rim))
    height = solid[2][3] / 0.095
    wall = solid[2][4] * RIM_M * height  # of the fuller box; the other's is a third of it
    for name, values in (
        ("prismoids over own footprints", plan),
        ("tetrahedra about the scanner", solid),
    ):
        chosen, cells = values[2], np.std([v[0] for v in values], ddof=1)
        sigma = float(np.sqrt(chosen[1] ** 2 + cells**2 + wall**2))
        out[f"{name}, L"] = 1e3 * chosen[0]
        out[f"{name}: sigma, L"] = 1e3 * sigma
        out[f"{name}: off the yardstick, %"] = 100.0 * (1e3 * chosen[0] / YARDSTICK_L - 1.0)
        out[f"{name}: sigma of noise, of cells, of the rim, L"] = " ".join(
            f"{1e3 * s:.3f}" for s in (chosen[1], cells, wall)
        )
    out["tetrahedra about the scanner: largest change over nine poles, L"] = 1e3 * solid[2][2]
    out["prismoids of all points, L"] = 1e3 * by_prismoids(many, few)[0]
    out["tetrahedra of all points, L"] = 1e3 * (by_tetrahedra(many)[0] - by_tetrahedra(few)[0])
    return out

"""Figures 9.2 to 9.16 of the thesis, of the simulated clouds: raw, filtered, meshed, with their
ground, and the volumes; all but the square filtered and meshed as published.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.clouds.published.filter_presets import preset
from ladar_volume.experiments import thesis_scene as scene
from ladar_volume.experiments.nist.nist_figures import panels
from ladar_volume.experiments.thesis import GROUND_THRESHOLD_M, tetrahedra_sum
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.mesh.local_mesh import BOX, FOUNTAIN, SPHERE, LocalMesh, mesh_cloud
from ladar_volume.model.body_parameters import LocalMeshParameters
from ladar_volume.model.parameters import FilterParameters, GroundParameters
from ladar_volume.model.records import F64, I32, Bool
from ladar_volume.report.plates import polygons, save_figure

#: From where clouds are seen: azimuth and elevation, radians; the light comes from the viewer.
AZIMUTH_RAD, ELEVATION_RAD = float(np.radians(-55.0)), float(np.radians(30.0))
#: Most points that are drawn; area, square points, of the dots of all of them.
SHOWN, DOTS = 60_000, 20_000.0
#: Colours of what stands and of the ground, and the darkest of a face.
BODY, GROUND, DARK = np.array([0.45, 0.62, 0.80]), np.array([0.80, 0.68, 0.48]), 0.35

Draw = Callable[[Axes], None]


@dataclass(frozen=True)
class Cloud:
    """One of the thesis's clouds. raw : (n, 3) m · filtered : (k, 3) m · mesh · on_ground : (k,)
    which points the ground is told by, none where there is no ground
    """

    raw: F64
    filtered: F64
    mesh: LocalMesh
    on_ground: Bool


def cloud(
    raw: F64,
    parameters: FilterParameters | None,
    settings: LocalMeshParameters | None,
    grounded: bool = True,
) -> Cloud:
    """A cloud filtered (None: settings from the cloud), meshed, and its ground found."""
    found = filter_cloud(raw, parameters or FilterParameters(), auto=parameters is None)
    mesh = mesh_cloud(found.r, found.normal, settings)
    on = np.zeros(len(found.r), np.bool_)
    if grounded:
        search = GroundParameters(threshold_m=GROUND_THRESHOLD_M)
        on[fit_ground(found.r, np.nan_to_num(found.sigma) ** 2, search).support] = True
    return Cloud(raw, found.r, mesh, on)


def camera() -> F64:
    """Rows (3, 3): to the right and up on the page, and towards the viewer."""
    c, s = np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD)
    a, b = np.cos(ELEVATION_RAD), np.sin(ELEVATION_RAD)
    return np.array([[-s, c, 0.0], [-b * c, -b * s, a], [a * c, a * s, b]])


def draw_points(r: F64, on_ground: Bool | None, title: str, ax: Axes) -> None:
    """Points (n, 3) m, the nearest last; those of the ground in its colour."""
    rows = np.arange(0, len(r), max(1, -(-len(r) // SHOWN)))
    at = r[rows] @ camera().T
    order = np.argsort(at[:, 2])
    if on_ground is None:
        colour = {"c": r[rows][order, 2], "cmap": "viridis"}
    else:
        colour = {"c": np.where(on_ground[rows, None], GROUND, BODY)[order]}
    size = float(np.clip(DOTS / len(rows), 1.0, 6.0))
    ax.scatter(at[order, 0], at[order, 1], s=size, linewidths=0, **colour)
    ax.set_title(f"{title}: {len(r):,} points")
    _finish(ax)


def draw_mesh(mesh: LocalMesh, on_ground: Bool, title: str, ax: Axes) -> None:
    """Triangles, the nearest last, darker the more they turn from the viewer; those of the ground
    in its colour.
    """
    t: I32 = mesh.triangles
    p = mesh.vertices[t]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    size = np.linalg.norm(normal, axis=1)
    view = camera()
    light = DARK + (1.0 - DARK) * np.abs(normal @ view[2]) / np.where(size > 0.0, size, 1.0)
    low = np.asarray(on_ground[t].all(axis=1))[:, None]
    colour = np.where(low, GROUND, BODY) * light[:, None]
    at = p @ view.T
    order = np.argsort(at[:, :, 2].mean(axis=1))
    ax.add_collection(polygons(at[order][:, :, :2], facecolors=colour[order], edgecolors="none"))
    ax.autoscale_view()
    ax.set_title(f"{title}: {len(t):,} triangles")
    _finish(ax)


def _finish(ax: Axes) -> None:
    """Equal scales, no frame."""
    ax.set_aspect("equal")
    ax.set_axis_off()


def _volume(mesh: LocalMesh, truth_m3: float) -> str:
    """The sum of tetrahedra, in words."""
    found = tetrahedra_sum(mesh)
    off = 100.0 * (found / truth_m3 - 1.0)
    return f"{found:.4f} m³ for {truth_m3:.4f} ({off:+.2f} %)"


def figures(large: int) -> dict[str, Draw]:
    """What draws each figure, by its number; the square's with ``large`` points, none for 0."""
    bench = cloud(scene.bench(0), preset("bench"), FOUNTAIN)
    stood = cloud(scene.box_on_ground(0), preset("box"), BOX)
    box = cloud(scene.box(0), preset("box"), BOX, False)
    ball = cloud(scene.sphere(0), preset("sphere"), SPHERE, False)
    out: dict[str, Draw] = {}
    for number, of, name in (
        (2, bench, "bench and fountain"),
        (3, stood, "box"),
        (4, ball, "sphere"),
    ):
        out[f"9.{number}"] = partial(draw_points, of.raw, None, f"{name}, raw")
        out[f"9.{number + 3}"] = partial(draw_points, of.filtered, None, f"{name}, filtered")
        out[f"9.{number + 6}"] = partial(draw_mesh, of.mesh, of.on_ground, f"{name}, mesh")
    for number, of, name in ((11, bench, "bench and fountain"), (12, stood, "box")):
        out[f"9.{number}"] = partial(draw_points, of.filtered, of.on_ground, f"{name}, ground")
    for number, of, truth in ((13, box, scene.BOX_M3), (14, ball, scene.SPHERE_M3)):
        out[f"9.{number}"] = partial(draw_mesh, of.mesh, of.on_ground, _volume(of.mesh, truth))
    if large:
        square = cloud(scene.square(large), None, None)
        out["9.15"] = partial(draw_points, square.raw, None, "square, raw")
        out["9.16"] = partial(draw_mesh, square.mesh, square.on_ground, "square, mesh and ground")
    return out


def write_figures(folder: Path, large: int) -> list[str]:
    """Every figure as a PNG; returns their names. Raises :class:`OutputError`."""
    names = []
    for number, draw in sorted(figures(large).items(), key=lambda item: float(item[0][2:])):
        figure, axes = panels(1, 1, 6.4, 4.8)
        draw(axes[0, 0])
        path = folder / f"figure_{number.replace('.', '_')}.png"
        names.append(save_figure(figure, path, dpi=130))
    return names

"""``ladar_volume study thesis``: chapter 9 of seed 002 repeated on simulated clouds, as published
and the package's own way.

As published: the filter of Tables 9.1 and 9.2 in its published order, Algorithm 2 with radius 10,
20 and 35 cm and each of the five ways to repair it, signed tetrahedra of whatever came out. The
package's own way on the same points: the filter with settings from the cloud, stars that agree,
edges completed, gaps closed, and the volume corrected for curvature. Times are of this machine.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.clouds.body_volume import body_of, cloud_uncertainty
from ladar_volume.clouds.filter_cloud import CloudResult, filter_cloud
from ladar_volume.clouds.published.filter_presets import preset
from ladar_volume.experiments import thesis_scene as scene
from ladar_volume.ground.polynomial import base_height, tilt_of
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.mesh.local_mesh import BOX, FOUNTAIN, SPHERE, LocalMesh, mesh_cloud
from ladar_volume.mesh.tetrahedra import signed_tetrahedra
from ladar_volume.mesh.topology import edge_table, orient
from ladar_volume.model.body_parameters import LocalMeshParameters
from ladar_volume.model.choices import REPAIRS
from ladar_volume.model.errors import SimulationError
from ladar_volume.model.parameters import FilterParameters, GroundParameters
from ladar_volume.model.records import F64

#: Largest gap that the package's own way closes, m; and what the ground is searched with: Table
#: 9.1's threshold, T = 1000.
CLOSE_M, GROUND_THRESHOLD_M = 0.4, 0.05


@dataclass(frozen=True)
class Mode:
    """One way to repair. triangles · volume_m3 · open, over_full : edges with one triangle, and
    with more than two · seconds
    """

    triangles: int
    volume_m3: float
    open: int
    over_full: int
    seconds: float


@dataclass(frozen=True)
class OwnBody:
    """The package's own way. points, vertices, triangles · volume_m3 : corrected · sigma_m3 ·
    uncorrected_m3 : without edges and curvature · watertight · euler : V − E + F of the closed mesh
    · closed_m3 · seconds
    """

    points: int
    vertices: int
    triangles: int
    volume_m3: float
    sigma_m3: float
    uncorrected_m3: float
    watertight: bool
    euler: int
    closed_m3: float
    seconds: float


@dataclass(frozen=True)
class Body:
    """One seed of box or sphere. filtered : points · seconds : of the filter · modes : by name ·
    own
    """

    filtered_points: int
    seconds: float
    modes: dict[str, Mode]
    own: OwnBody


@dataclass(frozen=True)
class Field:
    """A cloud with ground. raw, filtered : points · triangles, over_full : of the mesh ·
    edges_before, over_full_before : edges of the stars before they are brought to agree, NaN as
    published · height_m, tilt_rad : errors of the ground · seconds : of filter, mesh and ground
    """

    raw: int
    filtered: int
    triangles: int
    over_full: int
    edges_before: float
    over_full_before: float
    height_m: float
    tilt_rad: float
    seconds: tuple[float, float, float]


@dataclass(frozen=True)
class Study:
    """boxes, spheres : by seed · fields : bench as published, bench the package's way, box on
    ground as published, and the large cloud where asked for
    """

    boxes: list[Body]
    spheres: list[Body]
    fields: dict[str, Field]


def tetrahedra_sum(mesh: LocalMesh) -> float:
    """Signed tetrahedra to the middle of the vertices, m³, whether the mesh is closed or not."""
    return float(signed_tetrahedra(mesh.vertices, mesh.triangles, mesh.vertices.mean(axis=0)).sum())


def repair_modes(filtered: CloudResult, settings: LocalMeshParameters) -> dict[str, Mode]:
    """Algorithm 2 and each way to repair it."""
    out = {}
    for repair in REPAIRS:
        began = time.perf_counter()
        mesh = mesh_cloud(filtered.r, filtered.normal, dataclasses.replace(settings, repair=repair))
        seconds = time.perf_counter() - began
        out[repair] = Mode(
            len(mesh.triangles), tetrahedra_sum(mesh), len(mesh.rims), len(mesh.over_full), seconds
        )
    return out


def largest_part(mesh: LocalMesh) -> Any:
    """Triangles (m, 3) of the part with most of them: what outliers leave makes parts of its
    own.
    """
    whole = orient(mesh.vertices, mesh.triangles)
    return whole.triangles[whole.part == np.bincount(whole.part).argmax()]


def own_way(points: F64) -> OwnBody:
    """Filter, mesh, edges, closing, tetrahedra, curvature."""
    began = time.perf_counter()
    filtered = filter_cloud(points, FilterParameters(), auto=True)
    mesh = mesh_cloud(filtered.r, filtered.normal)
    body = body_of(
        mesh.vertices,
        largest_part(mesh),
        filtered.normal,
        filtered.curved,
        CLOSE_M,
        allow_crossings=True,
    )
    seconds = time.perf_counter() - began
    sigma = float(
        cloud_uncertainty([body], [np.arange(len(filtered.r))], points, filtered, None).sigma_m3[0]
    )
    closed = body.closed.mesh
    return OwnBody(
        len(filtered.r),
        closed.vertices,
        len(closed.triangles),
        body.volume_m3,
        sigma,
        body.uncorrected_m3,
        len(closed.boundary) == 0,
        closed.euler,
        body.closed_m3,
        seconds,
    )


def measure(points: F64, name: str, settings: LocalMeshParameters) -> Body:
    """One cloud both ways."""
    began = time.perf_counter()
    filtered = filter_cloud(points, preset(name))
    seconds = time.perf_counter() - began
    return Body(len(filtered.r), seconds, repair_modes(filtered, settings), own_way(points))


def field(
    points: F64,
    parameters: FilterParameters | None,
    settings: LocalMeshParameters | None,
    middle: F64,
) -> Field:
    """A cloud with ground at z = 0: filter (None: settings from the cloud), mesh, ground; its
    height is compared at ``middle`` (2,) m.
    """
    clock = [time.perf_counter()]
    filtered = filter_cloud(points, parameters or FilterParameters(), auto=parameters is None)
    clock.append(time.perf_counter())
    mesh = mesh_cloud(filtered.r, filtered.normal, settings)
    clock.append(time.perf_counter())
    ground = fit_ground(
        filtered.r,
        np.nan_to_num(filtered.sigma) ** 2,
        GroundParameters(threshold_m=GROUND_THRESHOLD_M),
    )
    clock.append(time.perf_counter())
    uses = np.diff(edge_table(mesh.triangles)[1])
    return Field(
        len(points),
        len(filtered.r),
        len(mesh.triangles),
        int(np.sum(uses > 2)),
        mesh.report.get("edges_before", np.nan),
        mesh.report.get("over_full_before", np.nan),
        float(base_height(ground, middle[None])[0]),
        tilt_of(ground),
        (clock[1] - clock[0], clock[2] - clock[1], clock[3] - clock[2]),
    )


def run(seeds: int, large: int = 0, progress: Callable[[str], None] = lambda text: None) -> Study:
    """Simulate and measure with seeds 0 to seeds − 1; ``large`` points of the square, 0 for none.
    Raises :class:`SimulationError`.
    """
    if seeds < 1:
        raise SimulationError(f"a study needs one seed or more, not {seeds}", value=seeds)
    boxes, spheres = [], []
    for seed in range(seeds):
        progress(f"seed {seed + 1} of {seeds}: box")
        boxes.append(measure(scene.box(seed), "box", BOX))
        progress(f"seed {seed + 1} of {seeds}: sphere")
        spheres.append(measure(scene.sphere(seed), "sphere", SPHERE))
    progress("bench and fountain")
    bench, middle = scene.bench(0), 0.5 * (scene.BENCH_LOW + scene.BENCH_HIGH)
    fields = {"bench and fountain, published": field(bench, preset("bench"), FOUNTAIN, middle)}
    fields["bench and fountain, own way"] = field(bench, None, None, middle)
    fields["box on ground, published"] = field(
        scene.box_on_ground(0), preset("box"), BOX, np.zeros(2)
    )
    if large:
        progress(f"{large:,} points of the square")
        fields[f"square of {large:,} points, own way"] = field(
            scene.square(large), None, None, np.zeros(2)
        )
    return Study(boxes, spheres, fields)


def errors_pct(bodies: list[Body], truth_m3: float) -> dict[str, F64]:
    """Error of the volume, %, of each seed by way: the five repairs, the package's own way, and
    that without its corrections.
    """
    out = {name: np.array([b.modes[name].volume_m3 for b in bodies]) for name in REPAIRS}
    out["own way"] = np.array([b.own.volume_m3 for b in bodies])
    out["own way, not corrected"] = np.array([b.own.uncorrected_m3 for b in bodies])
    return {name: 100.0 * (v / truth_m3 - 1.0) for name, v in out.items()}


def summary(study: Study) -> dict[str, Any]:
    """The numbers of the study as plain values."""
    facts: dict[str, Any] = {}
    for name, bodies, truth in (
        ("box", study.boxes, scene.BOX_M3),
        ("sphere", study.spheres, scene.SPHERE_M3),
    ):
        facts[name] = {
            "error_pct": {
                way: {
                    "mean": float(e.mean()),
                    "spread": float(e.std(ddof=1)) if len(e) > 1 else float("nan"),
                }
                for way, e in errors_pct(bodies, truth).items()
            },
            "triangles": {
                way: float(np.mean([b.modes[way].triangles for b in bodies])) for way in REPAIRS
            },
            "filtered": float(np.mean([b.filtered_points for b in bodies])),
            "watertight": all(b.own.watertight for b in bodies),
            "euler": [b.own.euler for b in bodies],
            **{
                name: [getattr(b.own, name) for b in bodies]
                for name in ("volume_m3", "sigma_m3", "closed_m3")
            },
        }
    facts["fields"] = {name: dataclasses.asdict(f) for name, f in study.fields.items()}
    return facts

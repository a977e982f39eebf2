"""What ``diff`` reads: clouds and meshes, positions, polygons, noise, and the refinement by the
ground around the region.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.change.excavation import Region, Scan, beam_noise, hull_polygon, select
from ladar_volume.change.isolated_returns import isolated_returns
from ladar_volume.change.spherical_tin import (
    build_spherical,
    normals_towards,
    stereographic,
    unit_directions,
    widest_gap,
)
from ladar_volume.cli.arguments.diff_input import numbers
from ladar_volume.cli.inputs.reading import mesh_in_metres, read_source
from ladar_volume.cli.inputs.rows import read_rows
from ladar_volume.clouds.cloud_surface import local_sigma
from ladar_volume.io.endings import READ_ENDINGS
from ladar_volume.io.meshfiles.mesh_files import MeshFile, read_mesh
from ladar_volume.io.pointfiles.cloud_files import PointFile, read_cloud
from ladar_volume.io.pointfiles.raw_table import FARTHEST
from ladar_volume.io.transforms import read_transform, read_transform_verdict
from ladar_volume.mesh.topology import orient
from ladar_volume.model.errors import ConfigurationError, InputError, SurfaceError, VolumeError
from ladar_volume.model.records import F64, I32
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.registration.transform import Transform

#: The cell of the refinement's covariance, as a part of A's larger side.
ICP_CELLS = 12.0
#: Share of returns that stand alone at which a scan is doubtful.
ISOLATED_SHARE = 0.02


@dataclass(frozen=True)
class ScanFile:
    """A file: points (n, 3) m in the map frame · triangles (m, 3), none for a cloud · closed : a
    mesh without boundary · sigma : (n,) m of the file, or None · transform : that was applied ·
    isolated_count : returns left out since they stand alone · verdict : on the file and the
    transform · cloud : as its file holds it, None for a mesh
    """

    path: Path
    points: F64
    triangles: I32
    closed: bool
    sigma: F64 | None
    transform: Transform | None
    isolated_count: int = 0
    verdict: Verdict = field(default_factory=Verdict)
    cloud: PointFile | None = None


@dataclass(frozen=True)
class Noise:
    """noise : a sigma, sigmas (n,), m, or covariances (n, 3, 3) m² · typical_m : its median · words
    : where it comes from
    """

    noise: float | F64
    typical_m: float
    words: str


def load(
    path: Path, transform: Path | None, arguments: argparse.Namespace, surface: str | None = None
) -> ScanFile:
    """Read a cloud or a mesh (of a LandXML the surface of that name) and bring it into the map
    frame.
    """
    T = None if transform is None else read_transform(transform)
    verdict = Verdict() if transform is None else read_transform_verdict(transform)
    r, triangles, sigma, found = read_any(path, arguments, surface)
    doubts = found.doubts if isinstance(found, MeshFile) else ()
    closed = False
    if len(triangles):
        try:
            closed = len(orient(r, triangles).boundary) == 0
        except SurfaceError as error:
            raise SurfaceError(
                f"{path}: {error}", reason=error.reason, value=error.value
            ) from error
    if len(triangles) and not closed:
        doubts += (unused_faces(path, len(triangles)),)
    cloud = None if isinstance(found, MeshFile) else found
    points = r if T is None else T.apply(r)
    return ScanFile(path, points, triangles, closed, sigma, T, 0, verdict + Verdict(doubts), cloud)


def unused_faces(path: Path, many: int) -> Doubt:
    """The doubt about an open mesh, of which the points alone are used."""
    text = (
        f"{path.name}: its {many:,} faces are not used, its points are triangulated about the "
        "scanner; surfaces over the map are compared by their faces with `ladar_volume volume`"
    )
    return Doubt("mesh_faces_unused", text, many)


def read_any(
    path: Path, arguments: argparse.Namespace, surface: str | None = None
) -> tuple[F64, I32, F64 | None, MeshFile | PointFile]:
    """Points (n, 3), m, triangles (m, 3), the column ``sigma`` (n,), where there is one, and the
    file. A PLY file without faces is a cloud.
    """
    if path.suffix.lower() in READ_ENDINGS:
        try:
            mesh = mesh_in_metres(read_mesh(path, surface), arguments)
            return mesh.vertices, mesh.triangles, None, mesh
        except InputError as error:
            if path.suffix.lower() != ".ply" or error.reason not in (
                "mesh_file_fields",
                "mesh_file_empty",
            ):
                raise
    cloud = read_source(path, arguments).cloud
    sigma = cloud.columns.get("sigma")
    good = (
        sigma is not None
        and sigma.dtype.kind in "fiu"
        and sigma.ndim == 1
        and bool((np.isfinite(sigma) & (sigma >= 0)).all())
    )
    values = np.asarray(sigma, np.float64) if good else None
    return cloud.r, np.zeros((0, 3), np.int32), values, cloud


def given_corners(polygon: Sequence[str] | None, selection: Path | None) -> F64 | None:
    """Corners (c, 2 or 3) of the region from the command line or a file; None without. Raises
    :class:`ConfigurationError`.
    """
    if selection is not None:
        return hull_polygon(read_cloud(selection, columns=False).r)
    if polygon is None:
        return None
    rows = [numbers(text) for text in polygon]
    if len(polygon) == 1 and not rows[0]:
        rows = read_rows(polygon[0], "--polygon")
    if len(rows) < 3 or len({len(r) for r in rows}) != 1 or len(rows[0]) not in (2, 3):
        raise ConfigurationError(
            "--polygon: at least three corners x,y (or x,y,z)", value=list(polygon)
        )
    corners = np.array(rows)
    if not (np.abs(corners) < FARTHEST).all():
        raise ConfigurationError(f"--polygon: a coordinate that is not below {FARTHEST:g}")
    return corners


def make_scan(file: ScanFile, scanner: F64 | None, pole: F64 | None) -> Scan:
    """A scan whose scanner is given in the file's frame; without it the pole is the scanner's place
    in the map.
    """
    if scanner is None:
        eye = np.zeros(3) if pole is None else pole
    else:
        eye = scanner if file.transform is None else file.transform.apply(scanner[None])[0]
    return Scan(file.points, eye, np.nan, file.transform)


def without_isolated(file: ScanFile, scan: Scan) -> ScanFile:
    """The file without the returns that stand alone, off every surface."""
    stays = ~isolated_returns(file.points, scan.scanner)
    if stays.all() or len(file.triangles):
        return file
    sigma = None if file.sigma is None else file.sigma[stays]
    return replace(file, points=file.points[stays], sigma=sigma, isolated_count=int((~stays).sum()))


def isolated_doubts(files: Sequence[ScanFile]) -> list[Doubt]:
    """The doubts of scans with many returns that stood alone."""
    out = []
    for name, file in zip("AB", files, strict=True):
        share = file.isolated_count / max(file.isolated_count + len(file.points), 1)
        if share > ISOLATED_SHARE:
            out.append(
                Doubt(
                    "isolated",
                    f"{100.0 * share:.1f} % of the returns of {name} stood alone, off every "
                    "surface, and were left out (--keep-isolated keeps them): some that lie near "
                    "the surface may be left; clean the scan (ladar_volume filter)",
                    share,
                )
            )
    return out


def sigma_of(scan: Scan, file: ScanFile, given: float | None, beam: bool) -> Noise:
    """Noise of a scan: as given, of the file's column, or from what local quadrics leave of its
    ranges, which lies along the beam.
    """
    if given is not None and not given >= 0.0:
        raise ConfigurationError(f"--sigma {given:g}: 0 or more", value=given)
    if given is None and file.sigma is None:
        direction, distance = unit_directions(scan.points, scan.scanner)
        seen = 2.0 * float(np.median(distance)) * stereographic(direction, widest_gap(direction))
        sigma: float | F64 = local_sigma(np.column_stack([seen, distance]))
        beam, words = True, "residuals of local quadrics, along the beam"
    else:
        sigma, words = (
            (given, "given") if given is not None else (np.asarray(file.sigma), "column 'sigma'")
        )
    typical = float(np.median(sigma))
    return Noise(beam_noise(scan.points, scan.scanner, sigma) if beam else sigma, typical, words)


def icp_doubts(icp: dict[str, Any], b: Scan) -> list[Doubt]:
    """The doubts of a refinement of scan B (as it was before) by the ground."""
    out = []
    if not icp["converged"]:
        out.append(
            Doubt(
                "icp_not_converged",
                f"the refinement did not settle in {icp['rounds']} steps: choose another reach "
                "(--icp), or register with spheres",
                icp["rounds"],
            )
        )
    budget = icp["reach_m"]
    if b.transform is not None:
        own = b.transform.covariances(b.transform.apply_inverse(b.points))
        sigma = float(np.sqrt(np.trace(own, axis1=1, axis2=2).mean()))
        budget = min(budget, max(3.0 * sigma, 3.0 * icp["sigma_m"]))
    if icp["moved_m"] > budget:
        out.append(
            Doubt(
                "icp_moved",
                f"the refinement moved B by {icp['moved_m']:.3g} m, further than the "
                f"{budget:.3g} m that its registration and the reach allow: check the registration",
                icp["moved_m"],
            )
        )
    return out


def refine_by_ground(
    a: Scan, b: Scan, region: Region, reach_m: float, cell_m: float | None
) -> tuple[Scan, dict[str, Any]]:
    """Scan B laid on scan A by the ground outside the region, and what the JSON says of it.

    Raises :class:`RegistrationError` as :func:`ladar_volume.registration.icp.refine` does,
    :class:`VolumeError` without ground.
    """
    from ladar_volume.io.epoch_registration import register_epochs  # Open3D only where asked for

    ground = unchanged_ground(a, b, region)
    cell = float(np.ptp(a.points, axis=0).max()) / ICP_CELLS if cell_m is None else cell_m
    found = register_epochs(
        ground.points_b, ground.vertices_a, ground.normals_a, reach_m=reach_m, cell_m=cell
    )
    T = found.transform
    noise = b.noise if np.ndim(b.noise) < 3 else T.R @ np.asarray(b.noise) @ T.R.T
    moved = Scan(T.apply(b.points), T.apply(b.scanner[None])[0], noise, T)
    shift = T.apply(b.points) - b.points
    facts = {
        "matrix": T.matrix().tolist(),
        "converged": found.converged,
        "moved_m": float(np.sqrt((shift**2).sum(axis=1).mean())),
        "reach_m": reach_m,
        "rounds": found.rounds,
        "pairs": len(found.pairs),
        "sigma_m": found.sigma_m,
        "overlap": found.overlap,
        "cell_m": cell,
        "sigma_rotation_rad": np.sqrt(np.diag(T.C)[:3]).tolist(),
        "sigma_shift_m": np.sqrt(np.diag(T.C)[3:6]).tolist(),
    }
    return moved, facts


@dataclass(frozen=True)
class UnchangedGround:
    """points_b : (k, 3) m of B outside the region · vertices_a, normals_a : (v, 3) m of A's surface
    there, and its unit normals; map frame
    """

    points_b: F64
    vertices_a: F64
    normals_a: F64


def unchanged_ground(a: Scan, b: Scan, region: Region) -> UnchangedGround:
    """Both scans outside the region. Raises :class:`VolumeError` where one has nothing there."""
    outside_a = ~select(a, a, region, 0.0)[0]
    outside_b = ~select(Scan(b.points, a.scanner, np.nan), b, region, 0.0)[0]
    tin = build_spherical(a.points, a.scanner).tin
    ground = outside_a[tin.source]
    if not ground.any() or not outside_b.any():
        raise VolumeError(
            "there is no ground outside the region to refine by", reason="region_ground"
        )
    return UnchangedGround(b.points[outside_b], tin.vertices[ground], normals_towards(tin)[ground])

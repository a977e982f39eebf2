"""Volume of closed meshes by signed tetrahedra about any pole, with gradient and covariance (seed
002 section 7.2, seed 003 section 3).

A triangle p1 p2 p3, counter-clockwise from outside, and the pole q span the signed volume ``(p1 −
q) · ((p2 − q) × (p3 − q)) / 6``. Over a closed mesh the sum does not depend on q; that it does not
is computed and printed, not assumed. The derivative by p1 is ``(p2 − q) × (p3 − q) / 6``. The
volume is linear in each vertex, so independent noise leaves it without bias, and its second-order
variance is exact: ``½ Σ tr(H_ab C_b H_abᵀ C_a)`` over ordered neighbours, with ``H_ab = [c − d]x /
6`` for the two corners c, d opposite the edge. Published meshes have edges with one triangle and
with several: there it is ``Σ ± [c − q]x / 6`` over their third corners, about the pole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.math.se3 import skew
from ladar_volume.mesh.crossed_space import (
    Crossing,
    check_crossing,
    crossing_of,
    winding_kernel,
)
from ladar_volume.mesh.topology import (
    OrientedMesh,
    check_closed,
    check_mesh,
    edge_table,
    orient,
    vertices_of,
)
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.model.records import F64, I32, Bool

#: A mesh whose faces lie no farther apart than so many roundings of its coordinates encloses
#: nothing.
FLAT = 64.0


@dataclass(frozen=True)
class ClosedVolume:
    """The volume of a closed mesh.

    volume_m3 · volumes_m3 : (k,), of each part; cavities are negative · gradient : (n, 3) m², by
    the vertices · area_m2 : of the surface · pole_map : (3,) m · pole_spread_m3 : largest change of
    the volume over nine other poles · mesh : the triangles as used, with parts · flipped : (m,)
    bool, triangles whose given orientation was not used · crossing : triangles that cross, None
    where no one looked for them
    """

    volume_m3: float
    volumes_m3: F64
    gradient: F64
    area_m2: float
    pole_map: F64
    pole_spread_m3: float
    mesh: OrientedMesh
    flipped: Bool
    crossing: Crossing | None = None


def signed_tetrahedra(vertices: F64, triangles: I32, pole_map: F64) -> F64:
    """Signed volumes (m,) m³ of the tetrahedra of triangles and pole (3,); of an open surface their
    sum depends on the pole.
    """
    return np.asarray(tetrahedra_kernel(vertices, triangles, pole_map))


@kernel
def tetrahedra_kernel(vertices: F64, triangles: I32, pole: F64) -> F64:
    """See :func:`signed_tetrahedra`."""
    out = np.empty(len(triangles))
    for t in range(len(triangles)):
        i, j, k = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, az = vertices[i, 0] - pole[0], vertices[i, 1] - pole[1], vertices[i, 2] - pole[2]
        bx, by, bz = vertices[j, 0] - pole[0], vertices[j, 1] - pole[1], vertices[j, 2] - pole[2]
        cx, cy, cz = vertices[k, 0] - pole[0], vertices[k, 1] - pole[1], vertices[k, 2] - pole[2]
        out[t] = (
            ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ) / 6.0
    return out


def tetrahedra_gradient(vertices: F64, triangles: I32, pole_map: F64) -> F64:
    """Derivative (n, 3) m² of the sum of :func:`signed_tetrahedra` by the vertices."""
    p = vertices[triangles] - pole_map
    corner = np.cross(p[:, [1, 2, 0]], p[:, [2, 0, 1]]) / 6.0
    flat, index = corner.reshape(-1, 3), triangles.ravel()
    return np.stack([np.bincount(index, flat[:, k], len(vertices)) for k in range(3)], axis=1)


def other_poles(vertices: F64) -> F64:
    """Nine poles (9, 3) m: the middle of the vertices' box and the corners of one three times as
    large.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    sign = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    middle = 0.5 * (low + high)
    return np.concatenate([middle[None], middle + 1.5 * sign * (high - low)])


def surface_area(vertices: F64, triangles: I32) -> float:
    """Area of triangles (m, 3), m²."""
    p = vertices[triangles]
    return 0.5 * float(np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1).sum())


def part_signs(vertices: F64, mesh: OrientedMesh, volumes: F64) -> F64:
    """Sign (k,) that each part's volume has to have: −1 for a cavity, which lies within an odd
    number of others, else +1.
    """
    parts = len(volumes)
    depth = np.zeros(parts, np.int64)
    rows = [np.flatnonzero(mesh.part == k) for k in range(parts)] if parts > 1 else []
    low = np.array([vertices[mesh.triangles[r]].min(axis=(0, 1)) for r in rows])
    high = np.array([vertices[mesh.triangles[r]].max(axis=(0, 1)) for r in rows])
    for k in range(len(rows)):
        around = np.flatnonzero((low <= low[k]).all(axis=1) & (high >= high[k]).all(axis=1))
        probe = vertices[mesh.triangles[rows[k][:: max(1, len(rows[k]) // 5)][:5]]].mean(axis=1)
        for o in around[around != k]:
            # the median over a few points: one of them may lie on the other part where the two
            # touch
            turns = winding_kernel(
                vertices, mesh.triangles[rows[o]], probe, np.full(len(probe), -1)
            )
            depth[k] += bool(np.median(np.abs(turns)) > 0.75)
    return np.where(depth % 2 == 1, -1.0, 1.0)


def closed_volume(
    vertices: F64, triangles: I32, pole_map: F64 | None = None, allow_crossings: bool = False
) -> ClosedVolume:
    """Volume of a closed mesh, whatever the orientation its triangles are given in.

    vertices : (n, 3) m, map frame · triangles : (m, 3) · pole_map : (3,) m, default the middle of
    the vertices' box. Parts are oriented outward, cavities inward. ``allow_crossings``: do not
    search for triangles that cross; space they enclose twice counts twice. Raises
    :class:`SurfaceError` (see :func:`~ladar_volume.mesh.topology.orient`; mesh_open for a mesh
    with a boundary, mesh_self_intersecting, mesh_flat for one that encloses nothing) and
    :class:`VolumeError` for a pole that is not three finite numbers.
    """
    v, _ = check_mesh(vertices, triangles)
    mesh = orient(v, triangles)
    check_closed(mesh)
    used = v[vertices_of(mesh.triangles)]
    poles = other_poles(used)
    pole = poles[0] if pole_map is None else np.asarray(pole_map, dtype=np.float64)
    if pole.shape != (3,) or not np.isfinite(pole).all():
        raise VolumeError("a pole is three finite numbers", reason="volume_pole", value=pole_map)
    raw = part_sums(mesh, signed_tetrahedra(v, mesh.triangles, poles[0]))
    check_thick(v, mesh, raw)
    turn = (np.where(raw < 0, -1.0, 1.0) != part_signs(v, mesh, raw))[mesh.part]
    out = mesh.triangles.copy()
    out[turn] = mesh.triangles[turn][:, [0, 2, 1]]
    mesh = OrientedMesh(
        out, mesh.flipped ^ turn, mesh.part, mesh.boundary, mesh.edges, mesh.vertices
    )
    volumes = part_sums(mesh, signed_tetrahedra(v, out, pole))
    total = float(volumes.sum())
    crossing = None if allow_crossings else crossing_of(v, out)
    if crossing is not None:
        check_crossing(crossing, total)
    spread = max(abs(float(signed_tetrahedra(v, out, q).sum()) - total) for q in poles)
    gradient = tetrahedra_gradient(v, out, poles[0])
    return ClosedVolume(
        total, volumes, gradient, surface_area(v, out), pole, spread, mesh, mesh.flipped, crossing
    )


def check_thick(vertices: F64, mesh: OrientedMesh, volumes: F64) -> None:
    """Raises :class:`SurfaceError` (mesh_flat; value: m) where no part, volumes (k,) m³, is thicker
    on the mean than coordinates round.
    """
    p = vertices[mesh.triangles]
    areas = part_sums(
        mesh, 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    )
    least = FLAT * float(np.spacing(np.abs(p).max()))
    if not (2.0 * np.abs(volumes) > least * areas).any():
        thickness = float(np.max(2.0 * np.abs(volumes) / np.maximum(areas, 1e-300)))
        raise SurfaceError(
            f"the closed mesh is flat, {thickness:.1e} m thick: it encloses no volume. "
            "Check the mesh's coordinates and units, or give "
            "more of the body",
            reason="mesh_flat",
            value=thickness,
        )


def part_sums(mesh: OrientedMesh, values: F64) -> F64:
    """Sums (k,) of one value per triangle, (m,), by part."""
    return np.bincount(mesh.part, values).astype(np.float64)


@dataclass(frozen=True)
class ClosedVariance:
    """first_m6 : ``Σ gᵀ C g`` · second_m6 : what the curvature of the volume adds; both for
    independent vertices
    """

    first_m6: float
    second_m6: float

    @property
    def sigma_m3(self) -> float:
        """Standard deviation of the volume, m³."""
        return float(np.sqrt(self.first_m6 + self.second_m6))


def vertex_covariances(noise: float | F64, n: int) -> F64:
    """Covariances (n, 3, 3) m² from one sigma, sigmas (n,), m, or covariances (n, 3, 3). Raises
    :class:`VolumeError` for anything else.
    """
    c = np.asarray(noise, dtype=np.float64)
    if c.shape in ((), (n,)):
        c = np.broadcast_to(c, (n,))[:, None, None] ** 2 * np.eye(3)
    if c.shape != (n, 3, 3) or not np.isfinite(c).all():
        raise VolumeError(
            f"noise of {n} vertices: a sigma, (n,) sigmas or (n, 3, 3), finite; not {c.shape}",
            reason="volume_noise",
        )
    return c


def closed_variance(vertices: F64, body: ClosedVolume, noise: float | F64) -> ClosedVariance:
    """Variance of a closed volume from independent errors of its vertices (n, 3), isotropic (m) or
    with covariances (n, 3, 3) m².

    What the vertices share (calibration, navigation, registration) enters by ``gradient`` and their
    sensitivities instead.
    """
    v = np.asarray(vertices, dtype=np.float64)
    C = vertex_covariances(noise, len(v))
    first = float(np.einsum("ni,nij,nj->", body.gradient, C, body.gradient))
    t = body.mesh.triangles
    order, start, _ = edge_table(t)
    first_half = order[start[:-1]]
    a, b = t.ravel()[first_half], t[:, [1, 2, 0]].ravel()[first_half]
    # of a closed mesh the pole drops out; open edges and those of several triangles keep it
    way = np.where(t.ravel()[order] == np.repeat(a, np.diff(start)), 1.0, -1.0)
    third = v[t[:, [2, 0, 1]].ravel()[order]] - body.pole_map
    H = skew(np.add.reduceat(way[:, None] * third, start[:-1])) / 6.0
    second = float(np.einsum("nij,njk,nlk,nli->", H, C[b], H, C[a]))
    return ClosedVariance(first, second)

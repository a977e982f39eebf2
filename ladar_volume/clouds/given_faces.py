"""The faces of a mesh as a surface over the map: what a file says is between its points.

A mesh with faces is its own triangulation: no triangle is added, so its footprint is that of the
faces and not the hull of the points, and its breaklines hold. It has to be a function of the
place: faces that stand on end have no footprint and no volume above a level, faces that lie over
one another are refused, and so is a closed mesh, which is a body. Which way round a face is given
makes no difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from ladar_volume.clouds.plan_overlap import Overlap, overlaps
from ladar_volume.mesh.topology import edge_table
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Tin
from ladar_volume.model.verdict import Doubt
from ladar_volume.tin.full_tin import across_sides, footprint_areas

#: Share of the footprint that may lie under a second face, as rounding folds slivers over: doubtful
#: up to here, refused above.
FOLDED = 1e-3
#: Share that is not worth a word.
NOTHING = 1e-9


@dataclass(frozen=True)
class GivenSurface:
    """tin : the faces, all relevant, ``source`` numbering the vertices in use · index : (n,) rows
    of these in the file · vertical : faces without footprint · clockwise_faces : faces given
    clockwise from above · unused_vertices : vertices in no face · parts : that no edge joins ·
    overlap : of the faces
    """

    tin: Tin
    index: I64
    vertical: int
    clockwise_faces: int
    unused_vertices: int
    parts: int
    overlap: Overlap


def without_footprint(vertices: F64, triangles: I32) -> tuple[F64, Bool]:
    """Signed areas (m,) m² in plan, and which triangles stand on end or are a line: their area is
    what rounding of their corners leaves.
    """
    area = footprint_areas(vertices, triangles)
    p = vertices[triangles][:, :, :2]
    long = np.abs(p - np.roll(p, 1, axis=1)).max(axis=(1, 2))
    step = float(np.spacing(np.abs(p).max()))
    return area, np.abs(area) <= 4.0 * step * long


def parts_of(neighbours: I32) -> int:
    """How many parts triangles with neighbours (m, 3) are, joined by edges."""
    t, k = np.nonzero(neighbours >= 0)
    m = len(neighbours)
    graph = coo_array((np.ones(len(t), np.int8), (t, neighbours[t, k])), shape=(m, m))
    return int(connected_components(graph, directed=False)[0])


def given_surface(vertices: F64, triangles: I32) -> GivenSurface:
    """The surface of faces (m, 3), each with three different corners, over vertices (n, 3) m.

    Raises :class:`SurfaceError`: surface_closed (a body), surface_vertical (no face has a
    footprint), surface_overlap (faces lie over one another; value: m²).
    """
    if not (np.diff(edge_table(triangles)[1]) % 2).any():
        raise SurfaceError(
            f"a closed mesh ({len(triangles):,} faces and no open edge) is a body and no surface: "
            "its volume is `ladar_volume body`; for a volume above a level cut off its underside",
            reason="surface_closed",
        )
    area, vertical = without_footprint(vertices, triangles)
    if vertical.all():
        raise SurfaceError(
            f"all {len(triangles):,} faces stand on end: they have no footprint; --frame scan "
            "turns a wall into its own plane",
            reason="surface_vertical",
        )
    kept, turned = triangles[~vertical].copy(), area[~vertical] < 0.0
    kept[turned] = kept[turned][:, [0, 2, 1]]
    used, inverse = np.unique(kept, return_inverse=True)
    faces = inverse.reshape(-1, 3).astype(np.int32)
    beside = across_sides(faces, len(used))
    m = len(faces)
    tin = Tin(vertices[used], faces, beside, np.ones(m, bool), np.arange(len(used), dtype=np.int64))
    found = GivenSurface(
        tin,
        used.astype(np.int64),
        int(np.count_nonzero(vertical)),
        min(int(turned.sum()), m - int(turned.sum())),
        len(vertices) - len(np.unique(triangles)),
        parts_of(beside),
        overlaps(tin),
    )
    check_overlap(found)
    return found


def check_overlap(found: GivenSurface) -> None:
    """Raises :class:`SurfaceError` (surface_overlap; value: m²) where more than :data:`FOLDED` of
    the footprint lies under a second face.
    """
    o, area = found.overlap, total_area(found.tin)
    if o.area_m2 > FOLDED * area:
        x, y = o.at_xy
        raise SurfaceError(
            f"{o.area_m2:.4g} m² of {area:.4g} m² lie under a second face ({o.pairs} pairs, the "
            f"largest at {x:.3f}, {y:.3f}): overhangs have no one height; use `ladar_volume body` "
            "or `diff`, leave the lower faces out, or --no-faces to triangulate the points",
            reason="surface_overlap",
            value=o.area_m2,
        )


def total_area(tin: Tin) -> float:
    """Area of the relevant triangles in plan, m²."""
    return float(footprint_areas(tin.vertices, tin.triangles)[tin.relevant].sum())


def doubts_of(found: GivenSurface) -> tuple[Doubt, ...]:
    """What is doubtful about a surface of given faces."""
    o, area = found.overlap, total_area(found.tin)
    if o.area_m2 <= NOTHING * area:
        return ()
    text = (
        f"{o.area_m2:.2g} m² ({100.0 * o.area_m2 / area:.2g} %) lie under a second face and count "
        f"twice, the largest at {o.at_xy[0]:.3f}, {o.at_xy[1]:.3f}: mend the mesh there"
    )
    return (Doubt("surface_overlap", text, o.area_m2),)

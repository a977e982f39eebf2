"""What the files of a result hold: the surface, where it counts, its base, the points it is made
from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.spatial import cKDTree

from ladar_volume.io.export.edge_rings import Polygon, polygons_of
from ladar_volume.io.export.outline_clip import clip_to_polygon
from ladar_volume.io.export.output_system import OutputSystem
from ladar_volume.io.export.positions import Positions, positions_of
from ladar_volume.io.pointfiles.point_file import PointFile
from ladar_volume.model.records import F64, I32, Bool, Tin
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.tin.locate import height_at
from ladar_volume.volume.polygon import signed_area


@dataclass(frozen=True)
class Part:
    """Triangles (m, 3) over vertices (n, 3), m, that the files hold under a name."""

    name: str
    vertices: F64
    triangles: I32


@dataclass(frozen=True)
class SurfacePoints:
    """r : (n, 3) m, the points a surface is made from · columns : (n,) or (n, k) each, lengths in m
    · like : the file they were read from, None for a survey
    """

    r: F64
    columns: Mapping[str, npt.NDArray[Any]]
    like: PointFile | None = None


@dataclass(frozen=True)
class Deliverable:
    """A result and what it was computed from, lengths in m.

    name : of the survey or cloud · tin : the surface · counted : (t,) triangles that V is summed
    over · base_m : (n,) height of the base at every vertex, linear between them; None where the
    base is another surface, or there is none · other : that surface · sigma_m : (n,) standard
    deviations of the heights of the vertices, None where they are not known · covariance : (n, n)
    m² of these heights where it is known; without it errors of neighbours are taken as common ·
    points : the points · breaklines : (k, 3) each, lines that the faces keep · outlines : polygons
    (k, 2) that cut off what counts, none where triangles count whole · facts : the result as in its
    JSON · rows : one volume each, for a table · system : of the files
    """

    name: str
    tin: Tin
    counted: Bool
    base_m: F64 | None
    other: Tin | None
    sigma_m: F64 | None
    covariance: sparse.csr_array | None
    points: SurfacePoints
    facts: Mapping[str, Any]
    rows: Sequence[Mapping[str, Any]]
    system: OutputSystem
    breaklines: Sequence[F64] = field(default_factory=tuple)
    outlines: Sequence[F64] = ()

    @cached_property
    def parts(self) -> list[Part]:
        """The surface where it counts, the rest of it, and the base under what counts (or the
        second surface); without a volume the surface as such.
        """
        known = self.base_m is not None
        base = self.base_m if self.base_m is not None else self.tin.vertices[:, 2]
        points, mine = np.column_stack([self.tin.vertices, base]), self.tin.triangles[self.counted]
        rest = self.tin.triangles[self.tin.relevant & ~self.counted]
        if self.outlines:
            points, mine, beyond = clipped_by_all(points, mine, self.outlines)
            rest = np.concatenate([rest, beyond])
        out = [part("counted" if self.rows else "surface", points[:, :3], mine)]
        if len(rest):
            out.append(part("around", points[:, :3], rest))
        if known:
            out.append(part("base", points[:, [0, 1, 3]], mine))
        elif self.other is not None:
            faces = self.other.triangles[self.other.relevant]
            out.append(part("second", self.other.vertices, faces))
        return out

    @cached_property
    def positions(self) -> Positions:
        """How places stand in GeoJSON."""
        return positions_of(self.system, self.tin.vertices)

    @cached_property
    def polygons(self) -> list[Polygon]:
        """Outlines of what counts: those given, in their order; found ones the largest first."""
        if not self.outlines:
            return polygons_of(self.tin, self.counted)
        # at the height of the surface, off it of its nearest point
        used = self.tin.vertices[np.unique(self.tin.triangles[self.tin.relevant])]
        tree, out = cKDTree(used[:, :2]), []
        for outline in self.outlines:
            z = height_at(self.tin, outline)
            nearest = used[tree.query(outline)[1], 2]
            ring = np.column_stack([outline, np.where(np.isfinite(z), z, nearest)])
            out.append(Polygon(ring, (), abs(signed_area(ring))))
        return out


def part(name: str, vertices: F64, triangles: I32) -> Part:
    """A part with the vertices that its triangles use."""
    used, inverse = np.unique(triangles, return_inverse=True)
    return Part(name, vertices[used], inverse.reshape(-1, 3).astype(np.int32))


def clipped_by_all(points: F64, triangles: I32, outlines: Sequence[F64]) -> tuple[F64, I32, I32]:
    """Points (n, c) and triangles (m, 3) cut along polygons (k, 2) that lie apart: the points, the
    triangles within any of them and the others.
    """
    inside: list[I32] = []
    for outline in outlines:
        cut = clip_to_polygon(points, triangles, outline)
        points, triangles = cut.points, cut.outside
        inside.append(cut.inside)
    return points, np.concatenate(inside), triangles


def faces_volume(
    tin: Tin, base_m: F64 | None, part_m2: F64 | Bool, outlines: Sequence[F64] = ()
) -> float | None:
    """Volume, m³, between the triangles that count (``part_m2`` (t,) above 0), as they are or cut
    off by outlines (k, 2), and the base (n,), m: what another program finds from the files. None
    without a base.
    """
    if base_m is None:
        return None
    triangles = tin.triangles[np.asarray(part_m2, dtype=np.float64) > 0.0]
    points = np.column_stack([tin.vertices, base_m])
    if outlines:
        points, triangles, _ = clipped_by_all(points, triangles, outlines)
    above = (points[:, 2] - points[:, 3])[triangles].mean(axis=1)
    return float((footprint_areas(points[:, :3], triangles) * above).sum())


def file_facts(faces: Sequence[float | None], system: OutputSystem) -> dict[str, Any]:
    """What the JSON says of the files: volumes between their faces, and their system."""
    return {
        "faces_m3": list(faces),
        "crs": system.name or None,
        "code": system.code or None,
        "wkt": system.wkt or None,
        "units": system.unit.name,
        "scale": system.scale,
    }


#: Columns of piles in a table.
PILE_COLUMNS = ("name", "material", "mass_t", "sigma_mass_t", "height_m")


def own_doubts(row: Mapping[str, Any]) -> str:
    """What is doubtful about one pile."""
    return "; ".join(reason["text"] for reason in row["verdict"]["reasons"])


def rows_of(
    facts: Mapping[str, Any], volumes: Sequence[Mapping[str, Any]], faces: Sequence[float | None]
) -> list[dict[str, Any]]:
    """One row a volume, of ``facts`` or of its bodies, for a table."""
    doubts = "; ".join(reason["text"] for reason in facts["verdict"]["reasons"])
    return [
        {
            "number": number,
            **{key: v[key] for key in PILE_COLUMNS if key in v},
            "volume_m3": v["net_m3"] if "net_m3" in v else v["volume_m3"],
            **{key: v[key] for key in ("sigma_m3", "confidence")},
            "low_m3": v["interval_m3"][0],
            "high_m3": v["interval_m3"][1],
            **{key: v[key] for key in ("cut_m3", "fill_m3", "area_m2", "base")},
            "faces_m3": of_faces,
            "doubts": own_doubts(v) if "name" in v else doubts,
        }
        for number, (v, of_faces) in enumerate(zip(volumes, faces, strict=True), 1)
    ]

"""What the maps of a report show: a surface with its heights above the base and their sigma."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.records import F64, I32, I64, Bool, Estimate, Plane, Tin
from ladar_volume.tin.full_tin import any_corner, vertex_mask
from ladar_volume.tin.locate import height_at, triangle_index
from ladar_volume.tin.predicates import WORKSPACE, orientation
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.uncertainty.pass_differences import between_bins

#: Places along a section, and the most on a map and at once.
PLACES, MOST_PLACES = 400, 100_000
#: Pixels along the longer side of a map, and the most triangles that all are drawn.
PIXELS, MOST_DRAWN = 700, 500_000


@dataclass(frozen=True)
class Pixels:
    """drawn : (t,) the triangles that count, of more than :data:`MOST_DRAWN` those at the middle of
    a pixel · at : (h, w) the number among these of that at the middle of each pixel, from the south
    up, -1 where there is none · extent : m, of its edges in the west, east, south, north
    """

    drawn: I64
    at: I64
    extent: tuple[float, float, float, float]

    @property
    def shown(self) -> Bool:
        """Pixels (h, w) with a triangle."""
        out: Bool = self.at >= 0
        return out


@dataclass(frozen=True)
class Path:
    """xyz_m : (p, 3) mean positions per time bin, map · status : (p,) of the fix nearest in time,
    as NavSatStatus; None where poses do not come from fixes
    """

    xyz_m: F64
    status: I64 | None


@dataclass(frozen=True)
class Residuals:
    """xy_m : (k, 2) places seen at several times, map · apart_m : (k,) how far the returns of each
    time lie off the surface through all of them, root mean square · edge_m : of a place
    """

    xy_m: F64
    apart_m: F64
    edge_m: float


@dataclass(frozen=True)
class Scene:
    """tin : the surface · counted : (t,) triangles that count · above_m : (n,) heights of the
    vertices above the base · sigma_m : (n,) their standard deviations, or None · outlines : each
    (k, 2), m, closed or not · base_at : height of the base at xy (k, 2), NaN outside · base : in
    words · where : the coordinate system in words · again : places of another pass, as
    ``MoreData.best`` gives them · gaps, objects : x, y, size of places that were not seen, and of
    what stands there and is not counted, m · path : of the scanner, or None · residuals : of its
    passes, or None · convergence : share of the recording, V and its standard deviation, m³
    """

    tin: Tin
    counted: Bool
    above_m: F64
    sigma_m: F64 | None
    outlines: Sequence[F64]
    base_at: Callable[[F64], F64]
    base: str
    where: str
    again: Sequence[Mapping[str, Any]] = ()
    gaps: Sequence[tuple[float, float, float]] = ()
    objects: Sequence[tuple[float, float, float]] = ()
    path: Path | None = None
    residuals: Residuals | None = None
    convergence: Sequence[tuple[float, float, float]] = ()

    def box(self) -> tuple[F64, F64]:
        """Least and greatest x and y, m, of the triangles that count."""
        own = self.tin.vertices[vertex_mask(self.tin, self.counted), :2]
        return own.min(axis=0), own.max(axis=0)

    @cached_property
    def pixels(self) -> Pixels:
        """The triangles that count as a map of pixels, which is drawn faster than as many polygons.
        Raises :class:`SurfaceError` where there is none.
        """
        if not self.counted.any():
            raise SurfaceError("there is no triangle to draw", reason="surface_no_relevant")
        tin, (low, high) = self.tin, self.box()
        size = float((high - low).max()) / PIXELS
        w, h = np.maximum(np.ceil((high - low) / size), 1).astype(np.int64).tolist()
        found = np.full((h, w), -1, np.int64)
        pixel_kernel(tin.vertices, tin.triangles, self.counted, low, size, found)
        drawn = np.flatnonzero(self.counted)
        if len(drawn) > MOST_DRAWN:
            drawn = np.unique(found[found >= 0])
        at = np.where(found >= 0, np.searchsorted(drawn, found), -1)
        return Pixels(drawn, at, (low[0], low[0] + w * size, low[1], low[1] + h * size))

    def corners(self) -> F64:
        """Corners (t, 3, 3), m, of the triangles that are drawn."""
        out: F64 = self.tin.vertices[self.tin.triangles[self.pixels.drawn]]
        return out

    def of_triangles(self, values: F64) -> F64:
        """Means (t,) over the triangles that are drawn, of values of the vertices (n,)."""
        out: F64 = values[self.tin.triangles[self.pixels.drawn]].mean(axis=1)
        return out


@leaf_kernel
def widen_span(a: F64, b: F64, y: float, size: float, span: F64) -> None:
    """Widen a span of x (2,) to where the side from a to b (2,) runs within ``size`` of a row."""
    rise = b[1] - a[1]
    one, two = 0.0, 1.0
    if rise != 0.0:
        one, two = (y - size - a[1]) / rise, (y + size - a[1]) / rise
        one, two = max(min(one, two), 0.0), min(max(one, two), 1.0)
    elif abs(a[1] - y) > size:
        return
    if one <= two:
        for share in (one, two):
            x = a[0] + share * (b[0] - a[0])
            span[0], span[1] = min(span[0], x), max(span[1], x)


@kernel
def pixel_kernel(
    vertices: F64, triangles: I32, counted: Bool, low: F64, size: float, out: I64
) -> None:
    """Write to each pixel (h, w) the lowest number of the ``counted`` (m,) triangles that hold its
    middle, edges included, told exactly; pixels of ``size`` from ``low`` (2,) on.
    """
    (h, w), work, span = out.shape, np.zeros(WORKSPACE), np.empty(2)
    for t in range(len(triangles)):
        if not counted[t]:
            continue
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        # one more on either side: the middles are rounded, too
        first = int((min(a[1], b[1], c[1]) - low[1]) / size - 1.5)
        last = int((max(a[1], b[1], c[1]) - low[1]) / size + 1.5)
        for i in range(max(first, 0), min(last + 1, h)):
            y = low[1] + (i + 0.5) * size
            span[0], span[1] = math.inf, -math.inf
            widen_span(a, b, y, size, span)
            widen_span(b, c, y, size, span)
            widen_span(c, a, y, size, span)
            if span[0] > span[1]:
                continue
            left = int((span[0] - low[0]) / size - 1.5)
            right = int((span[1] - low[0]) / size + 1.5)
            for j in range(max(left, 0), min(right + 1, w)):
                x = low[0] + (j + 0.5) * size
                if out[i, j] >= 0:
                    continue
                inside = orientation(a[0], a[1], b[0], b[1], x, y, work) >= 0.0
                inside = inside and orientation(b[0], b[1], c[0], c[1], x, y, work) >= 0.0
                if inside and orientation(c[0], c[1], a[0], a[1], x, y, work) >= 0.0:
                    out[i, j] = t


@dataclass(frozen=True)
class Section:
    """A vertical section: along_m (k,) from its west or south end, surface_m and base_m (k,) the
    heights, NaN where there is none · name : in words · ends : (2, 2) m
    """

    name: str
    ends: F64
    along_m: F64
    surface_m: F64
    base_m: F64 = field(repr=False)


def sections_of(scene: Scene) -> list[Section]:
    """Two sections through the middle of what counts: west to east, and south to north."""
    box = scene.box()
    outline = np.vstack([o for o in scene.outlines]) if scene.outlines else np.stack(box)
    low, high = outline.min(axis=0), outline.max(axis=0)
    low, high = low - 0.15 * (high - low), high + 0.15 * (high - low)
    low, high = np.maximum(low, box[0]), np.minimum(high, box[1])
    middle = 0.5 * (low + high)
    ends = {
        "west to east": np.array([[low[0], middle[1]], [high[0], middle[1]]]),
        "south to north": np.array([[middle[0], low[1]], [middle[0], high[1]]]),
    }
    return [_section(scene, name, each) for name, each in ends.items()]


def _section(scene: Scene, name: str, ends: F64) -> Section:
    share = np.linspace(0.0, 1.0, PLACES)[:, None]
    xy = ends[0] + share * (ends[1] - ends[0])
    length = float(np.linalg.norm(ends[1] - ends[0]))
    tin, fixed = scene.tin, int(ends[0, 0] != ends[1, 0])  # of x and y, that which stays
    off = tin.vertices[:, fixed] - ends[0, fixed]
    met = tin.relevant & any_corner(tin.triangles, off <= 0) & any_corner(tin.triangles, off >= 0)
    if met.any():
        surface = height_at(tin, xy, triangle_index(tin, met))
    else:
        surface = np.full(len(xy), np.nan)
    return Section(name, ends, share[:, 0] * length, surface, scene.base_at(xy))


def base_of_plane(plane: Plane | None) -> Callable[[F64], F64]:
    """Height of a base at xy (k, 2); zero for None."""

    def at(xy: F64) -> F64:
        out: F64 = -height_above(np.column_stack([xy, np.zeros(len(xy))]), plane)
        return out

    return at


def scene_of_survey(
    estimate: Estimate, epoch: Epoch, result: Mapping[str, Any], fixes: Sequence[tuple[int, int]]
) -> Scene:
    """The scene of a replayed survey. ``fixes``: t_ns and status of each."""
    tin = estimate.tin
    bodies = estimate.bodies or (estimate.volume,)
    return Scene(
        tin=tin,
        counted=np.asarray(tin.relevant, dtype=bool),
        above_m=height_above(tin.vertices, estimate.base),
        sigma_m=epoch.sigma_z(estimate.tin),
        outlines=[body.outline for body in bodies],
        base_at=base_of_plane(estimate.base),
        base=estimate.volume.base,
        where=where_of(result["datum"]),
        again=result["where_more_data_helps"]["places"],
        gaps=[(gap.x_m, gap.y_m, gap.size_m) for gap in estimate.volume.gaps],
        objects=[(one.x_m, one.y_m, one.size_m) for one in estimate.volume.objects],
        path=path_of(epoch, fixes),
        residuals=residuals_of(epoch),
        convergence=[
            (each["share"], each["volume_m3"], each["sigma_m3"])
            for each in result.get("convergence", ())
        ],
    )


def where_of(datum: Mapping[str, float] | None) -> str:
    """The frame of a survey in words."""
    if datum is None:
        return "map frame of the odometry"
    return (
        f"east, north, up about {datum['latitude_deg']:.7g}° N, {datum['longitude_deg']:.7g}° E, "
        f"{datum['height_m']:.1f} m (WGS 84, local tangent plane)"
    )


def path_of(epoch: Epoch, fixes: Sequence[tuple[int, int]]) -> Path | None:
    """Where the platform was, by time bin, with the status of the fix nearest in time."""
    bins = epoch.sources.navigation
    index, count, _, pose = bins.sums()
    if not len(index):
        return None
    xyz = pose[:, 0] / count[:, None]
    if not fixes:
        return Path(xyz, None)
    t, status = (np.array(each) for each in zip(*fixes, strict=True))
    order = np.argsort(t, kind="stable")
    t, status = t[order], status[order]
    middle = index * bins.bin_ns + bins.bin_ns // 2
    after = np.clip(np.searchsorted(t, middle), 1, max(len(t) - 1, 1)) if len(t) > 1 else 0 * index
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(t[before] - middle) <= np.abs(t[after] - middle), before, after)
    return Path(xyz, status[nearest])


def residuals_of(epoch: Epoch) -> Residuals | None:
    """How far the passes lie apart, patch by patch; None where no patch was seen twice."""
    patches = epoch.sources.patches
    rows = np.flatnonzero(np.diff(patches.nav_start) > 1).astype(np.int64)
    some = [
        between_bins(patches, rows[first : first + MOST_PLACES])
        for first in range(0, len(rows), MOST_PLACES)
    ]
    known = [square for square in some if square is not None]
    if not known or len(known) < len(some):
        return None
    square = np.concatenate(known)
    edge = epoch.sources.parameters.filter.radius_m
    return coarser(Residuals(patches.centre[rows, :2], np.sqrt(square), edge))


def coarser(found: Residuals) -> Residuals:
    """The root mean squares by larger places, where there are more than :data:`MOST_PLACES`."""
    n = len(found.xy_m)
    if n <= MOST_PLACES:
        return found
    edge, low = found.edge_m * math.ceil(math.sqrt(n / MOST_PLACES)), found.xy_m.min(axis=0)
    cell = np.floor((found.xy_m - low) / edge).astype(np.int64)
    width = int(cell[:, 1].max()) + 1
    used, number = np.unique(cell @ [width, 1], return_inverse=True)
    square = np.bincount(number, found.apart_m**2) / np.bincount(number)
    xy = low + edge * (np.stack(np.divmod(used, width), axis=1) + 0.5)
    return Residuals(xy, np.sqrt(square), edge)

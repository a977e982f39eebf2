"""Planar patches that two strips or more have seen, found robustly while the strips still disagree.

Each strip's points count about their own mean, so an offset between strips neither tilts a patch
nor makes it look rough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.equal_rows import distinct_cells
from ladar_volume.math.packed_covariance import unpack
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.records import F64, I64

#: Points farther than this many robust sigma from their patch are left out.
OUTLIER_SIGMAS = 3.5
#: A patch more than this many times rougher than the usual one is no plane.
_ROUGH = 1.5
#: Least extent of a patch in both directions, as standard deviation over the edge of its voxel (a
#: full square has 0.29).
_EXTENT = 0.1
_SWEEPS = 3
#: Normals within this many edges and this angle are averaged.
_NEIGHBOURS, _ALIKE_RAD = 3.0, np.radians(10.0)


@dataclass(frozen=True)
class Overlap:
    """Patches seen by several strips.

    point : (n,) index of the points that lie on a patch · patch : (n,) number of each point's patch
    · group : (n,) number of its patch and strip · X : (n, 3) design rows (1, u, v), m · height :
    (n,) m above the patch's plane · normal : (p, 3) · steady : (p, 3) normals averaged over
    neighbours, for sensitivities · patch_of : (g,) patch of each group · strip_of : (g,) strip of
    each group
    """

    point: I64
    patch: I64
    group: I64
    X: F64
    height: F64
    normal: F64
    steady: F64
    patch_of: I64
    strip_of: I64


def overlap(
    r_map: F64, strip: I64, C: F64, edge_m: float, min_points: int, max_patches: int
) -> Overlap:
    """Patches of points r_map (n, 3) m seen in strips (n,), with noise C (n, 3, 3) m².

    Raises :class:`CalibrationError` (calibration_no_overlap) where no patch is seen by two strips.
    """
    point, patch = np.arange(len(r_map)), voxel_numbers(r_map, edge_m)
    for _ in range(_SWEEPS):
        point, patch, group, _, _ = _select_shared_patches(point, patch, strip, min_points)
        if len(point) == 0:
            raise CalibrationError(
                (
                    f"no surface of {edge_m:g} m was seen by two strips with {min_points} "
                    "returns each: strips must overlap"
                ),
                reason="calibration_no_overlap",
                value=0,
            )
        d = r_map[point] - _means(r_map[point], group)[group]
        normal, _, extent = _planes(d, patch)
        along = np.einsum("ni,ni->n", d, normal[patch])
        scale = 1.4826 * medians(np.abs(along), patch)
        n = normal[patch]
        expected = np.sqrt(_means(np.einsum("ni,nij,nj->n", n, C[point], n)[:, None], patch)[:, 0])
        ratio = scale / expected
        flat = (ratio <= _ROUGH * max(1.0, float(np.median(ratio)))) & (extent >= _EXTENT * edge_m)
        good = flat[patch] & (np.abs(along) <= OUTLIER_SIGMAS * np.maximum(scale, expected)[patch])
        point, patch = point[good], patch[good]
    return fit_planes(r_map, strip, point, patch, edge_m, min_points, max_patches)


def voxel_numbers(r_map: F64, edge_m: float) -> I64:
    """Number (n,) of the cell that holds each point: square columns, cut in height about the median
    height of each.

    A face of a cell must not run within the noise of a level surface: it would sort the noise of
    its points.
    """
    _, column = distinct_cells(np.floor(r_map[:, :2] / edge_m).astype(np.int64))
    storey = np.floor((r_map[:, 2] - medians(r_map[:, 2], column)[column]) / edge_m + 0.5)
    return distinct_cells(np.column_stack([column, storey.astype(np.int64)]))[1]


def fit_planes(
    r_map: F64, strip: I64, point: I64, patch: I64, edge_m: float, min_points: int, max_patches: int
) -> Overlap:
    """Planes of given points (n,) on given patches (n,), each strip's points about their own mean.
    Raises as :func:`overlap`.
    """
    point, patch, group, patch_of, strip_of = _select_shared_patches(
        point, patch, strip, min_points, max_patches
    )
    if len(point) == 0:
        raise CalibrationError(
            "no patch that two strips saw is a plane", reason="calibration_no_overlap", value=0
        )
    centre = _means(r_map[point], patch)
    d = r_map[point] - centre[patch]
    within = r_map[point] - _means(r_map[point], group)[group]
    normal, tangents, _ = _planes(within, patch)
    uv = np.einsum("nij,ni->nj", tangents[patch], d)
    X = np.column_stack([np.ones(len(d)), uv])
    height = np.einsum("ni,ni->n", d, normal[patch])
    return Overlap(
        point,
        patch,
        group,
        X,
        height,
        normal,
        average_normals(centre, normal, _NEIGHBOURS * edge_m),
        patch_of,
        strip_of,
    )


def average_normals(centre: F64, normal: F64, radius_m: float) -> F64:
    """Normals (p, 3), each averaged with those like it within a radius.

    The noise of a small patch's normal, times the distance to the scanner, would pass for a
    sensitivity to horizontal shifts: on level ground it feigns knowledge of the heading. A normal
    that hardly shares the patch's own noise does not.
    """
    pairs = cKDTree(centre).query_pairs(radius_m, output_type="ndarray")
    a, b = np.concatenate([pairs, pairs[:, ::-1]]).T
    cosine = np.einsum("ni,ni->n", normal[a], normal[b])
    alike = np.abs(cosine) > np.cos(_ALIKE_RAD)
    total = normal.copy()
    np.add.at(total, a[alike], np.sign(cosine[alike])[:, None] * normal[b[alike]])
    out: F64 = total / np.linalg.norm(total, axis=1, keepdims=True)
    return out


def _select_shared_patches(
    point: I64, patch: I64, strip: I64, min_points: int, max_patches: int | None = None
) -> tuple[I64, I64, I64, I64, I64]:
    """Cut to groups of enough points, and patches of two groups or more: point, patch, group (all
    (n,)), patch and strip of each group.
    """
    strips = int(strip.max(initial=0)) + 1
    keys, group, count = np.unique(
        patch * strips + strip[point], return_inverse=True, return_counts=True
    )
    enough = count >= min_points
    several = np.bincount(keys[enough] // strips, minlength=int(patch.max(initial=0)) + 1) >= 2
    if max_patches is not None and np.count_nonzero(several) > max_patches:
        chosen = np.random.default_rng(1).permutation(np.flatnonzero(several))[:max_patches]
        several = np.isin(np.arange(len(several)), chosen)
    good = enough[group] & several[patch]
    point, patch = point[good], patch[good]
    _, patch = np.unique(patch, return_inverse=True)
    keys, group = np.unique(patch * strips + strip[point], return_inverse=True)
    return point, patch, group, keys // strips, keys % strips


def _means(values: F64, label: I64) -> F64:
    """Means (k, c) of values (n, c) by label (n,)."""
    count = np.maximum(np.bincount(label), 1)
    return np.stack(
        [np.bincount(label, values[:, c]) / count for c in range(values.shape[1])], axis=1
    )


def _planes(d: F64, patch: I64) -> tuple[F64, F64, F64]:
    """Normals (p, 3), tangents (p, 3, 2) and the lesser extent in the plane (p,) m of offsets d (n,
    3).
    """
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    packed = _means(np.stack([d[:, a] * d[:, b] for a, b in pairs], axis=1), patch)
    value, vector = np.linalg.eigh(unpack(packed))
    return vector[:, :, 0], vector[:, :, 1:], np.sqrt(np.maximum(value[:, 1], 0.0))


def medians(values: F64, label: I64) -> F64:
    """Lower medians (k,) of values (n,) by label (n,), every label from 0 on present: always one of
    the values, never halfway between two surfaces.
    """
    order = np.lexsort((values, label))
    count = np.bincount(label)
    start = np.cumsum(count) - count
    ordered = values[order]
    out: F64 = ordered[start + (count - 1) // 2]
    return out

"""Where more data would help most: by how much sigma of the volume would fall if one place were
flown over once more.

The surface is cut into square cells. A further pass over a cell makes its heights the means of two
with errors of their own: noise of the returns, Gauss-Markov and white navigation. With ``a`` the
cell's part of the volume's error and ``T`` the whole, the variance falls by ``Cov(T, a) − ½
Var(a)``. What stays the same over the survey (calibration, the constant part of the navigation) no
pass takes away.

Where returns are missing, large triangles span what was not seen. How wrong a height half way along
an edge of length L is, the survey itself tells: by the second difference of its heights at that
distance. The budget holds it in the line ``unseen``; here it stands beside the rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.model.records import F64, I64, Bool, Tin
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.load_kernels import cell_kernel, pair_falls_kernel
from ladar_volume.uncertainty.navigation_sum import markov_sum, navigation_loads
from ladar_volume.uncertainty.packing import bin_rows, factor_loads
from ladar_volume.uncertainty.propagation import patch_loads
from ladar_volume.uncertainty.volume_budget import Sources
from ladar_volume.volume.outline import components, fill_parts

#: Cells along the side of a square as large as the surface, and triangles with an edge so many
#: times the usual one are gaps.
CELLS, GAP = 12, 4.0
#: Distances at which the relief is looked at, and places at each.
SCALES, PLACES = 6, 1000
SOURCES = ("noise", "position", "attitude", "gap")


@dataclass(frozen=True)
class MoreData:
    """centre_map : (k, 3) m, middle of each cell at the mean height there · sigma_m : (k,) mean
    sigma of height, all sources · falls_m6 : (k, 4) by how much the variance of the volume would
    fall, by :data:`SOURCES` · sigma_m3 : of the volume, without gaps · sigma_gaps_m3 : of what lies
    in gaps · cell_m : side of a cell
    """

    sources: ClassVar[tuple[str, ...]] = SOURCES
    centre_map: F64
    sigma_m: F64
    falls_m6: F64
    sigma_m3: float
    sigma_gaps_m3: float
    cell_m: float

    @property
    def gain_m3(self) -> F64:
        """By how much sigma, gaps included, would fall after another pass over each cell (k,),
        m³.
        """
        total = self.sigma_m3**2 + self.sigma_gaps_m3**2
        out: F64 = math.sqrt(total) - np.sqrt(
            np.clip(total - self.falls_m6.sum(axis=1), 0.0, total)
        )
        return out

    def best_cells(self, count: int = 3) -> list[dict[str, float | str]]:
        """The cells where another pass would help most, at most ``count``: place (m), gain (m³) and
        what for.
        """
        gain = self.gain_m3
        order = [int(i) for i in np.argsort(-gain, kind="stable")[:count] if gain[i] > 0.0]
        return [
            {
                "x_m": float(self.centre_map[i, 0]),
                "y_m": float(self.centre_map[i, 1]),
                "z_m": float(self.centre_map[i, 2]),
                "gain_m3": float(gain[i]),
                "sigma_height_m": float(self.sigma_m[i]),
                "why": SOURCES[int(np.argmax(self.falls_m6[i]))],
            }
            for i in order
        ]


def noise_falls(gradient: F64, q: F64, sources: Sources, patch_cell: I64, cells: int) -> F64:
    """(cells,) m⁶ from the returns' noise, for a gradient (n, 3) by points and loads q (m, p +
    2).
    """
    g, patches = sources.geometry, sources.patches
    q = factor_loads(q[:, :, None], patches)[:, :, 0]
    between = pair_falls_kernel(q, g.start, g.right, patches.cross, patch_cell, cells)
    (x, y, z), C = gradient.T, sources.points.C_tangent.T
    tangent = (
        C[0] * x * x
        + C[3] * y * y
        + C[5] * z * z
        + 2.0 * (C[1] * x * y + C[2] * x * z + C[4] * y * z)
    )
    out: F64 = between + 0.5 * np.bincount(patch_cell[g.row], tangent, cells)
    return out


def markov_product(t: F64, y: F64, tau: float) -> F64:
    """``Σ_f y_f exp(−|t_e − t_f| / tau)`` (n, k) for ascending times t (n,) s and rows y (n, k), by
    the exact recursion.
    """
    out, decay = y.copy(), np.exp(-np.diff(t) / tau)
    ahead, behind = np.zeros_like(y), np.zeros_like(y)
    for e in range(1, len(t)):
        ahead[e] = decay[e - 1] * (ahead[e - 1] + y[e - 1])
    for e in range(len(t) - 2, -1, -1):
        behind[e] = decay[e] * (behind[e + 1] + y[e + 1])
    out += ahead + behind
    return out


def sum_by_label(label: I64, values: F64, groups: int) -> F64:
    """Sums (groups, c) of rows (n, c) by label (n,)."""
    out = np.empty((groups, values.shape[1]))
    for c in range(values.shape[1]):
        out[:, c] = np.bincount(label, values[:, c], groups)
    return out


def navigation_falls(q: F64, sources: Sources, patch_cell: I64, cells: int) -> F64:
    """(cells, 2) m⁶ from position and attitude, for loads q (m, p + 2)."""
    b, gap = sources.parameters.budget, sources.parameters.georeference.max_position_gap_s
    patches, out = sources.patches, np.zeros((cells, 2))
    bins, index = sources.time_bins
    order = np.argsort(patch_cell, kind="stable")
    starts, at, J = cell_kernel(q, bin_rows(patches, index), order, patch_cell, cells, len(bins))
    loads = navigation_loads(J, bins[at], sources.navigation, gap)
    t_s = (bins - (bins[0] if len(bins) else 0)) * (sources.navigation.bin_ns * 1e-9)
    for k, (y, n, bias, white, tau) in enumerate(
        (
            (
                loads.position,
                loads.fixes,
                b.position_bias_fraction,
                b.position_white_fraction,
                b.tau_position_s,
            ),
            (
                loads.attitude,
                loads.samples,
                b.attitude_bias_fraction,
                b.attitude_white_fraction,
                b.tau_attitude_s,
            ),
        )
    ):
        whole = sum_by_label(at, y, len(bins))
        markov = markov_product(t_s, whole, tau)[at]
        cov = y * ((1.0 - bias - white) * markov + white * whole[at] / n[:, None])
        for cell in range(cells):
            own = slice(starts[cell], starts[cell + 1])
            var = (1.0 - bias - white) * float(
                markov_sum(loads.t_s[own], np.ascontiguousarray(y[own]), tau)
            )
            var += white * float(((y[own] ** 2).sum(axis=1) / n[own]).sum())
            out[cell, k] = float(cov[own].sum()) - 0.5 * var
    return out


def longest_edges(tin: Tin, triangles: I64) -> F64:
    """Longest edge (k,) m in plan of triangles (k,)."""
    r = tin.vertices[tin.triangles[triangles], :2]
    out: F64 = np.sqrt(((r - np.roll(r, 1, axis=1)) ** 2).sum(axis=2)).max(axis=1)
    return out


def relief(r: F64, variance: F64, lengths: F64) -> F64:
    """How wrong (k,) m, root mean square, a height half way between two is, for distances (k,) m:
    second differences of heights at points r (n, 3) with variances (n,) m²; NaN where no three
    stand so.
    """
    tree, out = cKDTree(r[:, :2]), np.full(len(lengths), np.nan)
    middle = np.arange(0, len(r), max(1, len(r) // PLACES))
    for k, length in enumerate(lengths):
        error = np.concatenate(
            [beyond_chord(r, variance, tree, middle, 0.5 * length * axis) for axis in np.eye(2)]
        )
        if len(error):
            out[k] = math.sqrt(max(float(error.mean()), 0.0))
    return out


def beyond_chord(r: F64, variance: F64, tree: cKDTree, middle: I64, step: F64) -> F64:
    """Squared distances (j,) m², less their noise, of heights at points ``middle`` (k,) from the
    chord between the points nearest to one step (2,) m either way, where there are such points.
    """
    d, one = (np.asarray(x) for x in tree.query(r[middle, :2] + step))
    mirror, two = (np.asarray(x) for x in tree.query(2.0 * r[middle, :2] - r[one, :2]))
    near = 0.2 * float(np.linalg.norm(step))
    good = (d <= near) & (mirror <= near)
    i, a, b = middle[good], one[good], two[good]
    chord = r[b, :2] - r[a, :2]
    t = ((r[i, :2] - r[a, :2]) * chord).sum(axis=1) / (chord**2).sum(
        axis=1
    )  # the three hardly lie on one line
    error = r[i, 2] - (1.0 - t) * r[a, 2] - t * r[b, 2]
    out: F64 = error**2 - variance[i] - (1.0 - t) ** 2 * variance[a] - t**2 * variance[b]
    return out


def enclosed_triangles(tin: Tin, inside: Bool) -> Bool:
    """Triangles (m,) that do not count, such as those with edges too long, but lie wholly among
    ones that do.
    """
    out: Bool = (
        fill_parts(tin.neighbours, np.ones(len(inside), np.bool_), inside, components(tin, ~inside))
        & ~inside
    )
    return out


def gap_sigmas(tin: Tin, inside: Bool, rows: I64, variance: F64) -> F64:
    """Sigma (k,) m³ of what lies under each of the triangles rows (k,) that spans a gap, 0 for the
    others. inside : (m,) triangles that count · variance : (n,) m² of the vertex heights.
    """
    out, longest = np.zeros(len(rows)), longest_edges(tin, rows)
    usual = float(np.median(longest[inside[rows]]))
    wide = longest > GAP * usual
    if not wide.any():
        return out
    used = np.unique(tin.triangles[rows])
    lengths = np.geomspace(2.0 * usual, float(longest.max()), SCALES)
    rough = relief(tin.vertices[used], variance[used], lengths)
    known = np.isfinite(rough)
    if known.any():
        area = footprint_areas(tin.vertices, tin.triangles[rows[wide]])
        out[wide] = area * np.interp(longest[wide], lengths[known], rough[known])
    return out


def cell_gaps(cell: I64, sigma: F64, cells: int, unseen_m6: float) -> F64:
    """Sigma (c,) m³ of what is not seen in each cell, which errs as one, from that (n,) of the
    triangles of each cell (n,); scaled to the variance ``unseen_m6`` of all of it, where known.
    """
    gaps: F64 = np.bincount(cell, sigma, cells).astype(np.float64)
    if unseen_m6 > 0.0 and gaps.any():
        gaps = np.sqrt(unseen_m6 / float(gaps @ gaps)) * gaps
    return gaps


def cell_means(cell: I64, value: F64, cells: int) -> F64:
    """Mean (c,) of the values (n,) in each cell (n,), 0 where there are none."""
    number = np.maximum(np.bincount(cell, minlength=cells), 1)
    return np.asarray(np.bincount(cell, value, cells) / number)


def middles(tin: Tin, rows: I64) -> F64:
    """Centroids (k, 3) m of triangles (k,)."""
    a, b, c = (tin.vertices[corner] for corner in tin.triangles[rows].T)
    return np.asarray((a + b + c) / 3.0)


def map_cells(xy: F64, counts: Bool) -> tuple[I64, F64, float]:
    """Square cells of the map over those points xy (n, 2) m that count (n,): the cell of each point
    (n,), the middles (c, 2) m of the cells that hold any, and their side, m.
    """
    low = xy[counts].min(axis=0)
    side = xy[counts].max(axis=0) - low
    cell_m = max(math.sqrt(max(float(side[0] * side[1]), 1e-12)), float(side.max()) / CELLS) / CELLS
    place = np.floor((xy - low) / cell_m).astype(np.int64)
    first = place.min(axis=0)
    row = int(place[:, 1].max() - first[1]) + 1
    numbers, label = np.unique((place - first) @ [row, 1], return_inverse=True)
    places = first + np.stack(np.divmod(numbers, row), axis=1)
    return label, low + (places + 0.5) * cell_m, cell_m


def more_data(
    tin: Tin,
    inside: Bool,
    gradient: F64,
    sources: Sources,
    sigma_z: F64,
    variance: F64,
    sigma_m3: float,
    unseen_m6: float = 0.0,
) -> MoreData:
    """The map of what another pass would buy, for a volume with gradient (n, 3) by the points and
    sigma_m3, without what was not seen: where known, unseen_m6 is its variance, which the gaps
    share as their relief.

    inside : (m,) triangles that count · sigma_z, variance : (v,) m, m², total sigma and variance
    from noise of each vertex' height.
    """
    patches, rows = sources.patches, np.flatnonzero(inside | enclosed_triangles(tin, inside))
    q = np.ascontiguousarray(patch_loads(gradient[:, None], patches, sources.geometry)[:, :, 0])
    loaded: Bool = np.any(q != 0.0, axis=1)
    middle = middles(tin, rows)
    xy = np.concatenate([patches.centre[:, :2], middle[:, :2]])
    label, corner, cell_m = map_cells(xy, np.append(loaded, np.ones(len(rows), np.bool_)))
    cells, of_patch, of_triangle = len(corner), label[: len(patches)], label[len(patches) :]
    gaps = cell_gaps(of_triangle, gap_sigmas(tin, inside, rows, variance), cells, unseen_m6)
    noise = noise_falls(gradient, q, sources, of_patch, cells)
    fall = np.c_[noise, navigation_falls(q, sources, of_patch, cells), gaps**2]
    used = np.bincount(of_patch, loaded, cells) + np.bincount(of_triangle, minlength=cells) > 0
    of_vertex = np.concatenate([of_patch[sources.geometry.row[tin.source]], of_triangle])
    of_middle = sigma_z[tin.triangles[rows]].mean(axis=1)
    z = cell_means(of_vertex, np.concatenate([tin.vertices[:, 2], middle[:, 2]]), cells)
    sigma = cell_means(of_vertex, np.concatenate([sigma_z, of_middle]), cells)
    return MoreData(
        np.c_[corner, z][used],
        sigma[used],
        fall[used],
        sigma_m3,
        math.sqrt(float((gaps**2).sum())),
        cell_m,
    )

"""The filter stage: robust moving least squares on a stream (seed 002 chapter 4; UNCERTAINTY steps 3 and 4).

Raw points go into capped voxels of edge r. Every occupied voxel has one patch, fitted over 2r; each raw point is
projected once, by the patch of its own voxel. An update refits what new points touched and replaces it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.filtering import admission, cross, kernels, project, sensitivity
from ladar_volume.filtering.fit import OK, REACH
from ladar_volume.filtering.store import HALF, VoxelStore
from ladar_volume.georeference.lidar import mounting
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    F64,
    I64,
    Bool,
    FilteredPoints,
    FilterUpdate,
    MappedPoints,
    Patches,
    PlatformStates,
    concatenate,
    select,
)

#: Platform states older than this before the newest are forgotten once no point waits for them.
KEEP_NS = 30_000_000_000


@dataclass(frozen=True)
class _Fits:
    """Fits of a set of voxels; row-wise, with inlier slots in CSR form."""

    voxels: I64
    start: I64
    members: I64
    used: I64
    status: I64
    sigma: F64
    time: I64
    centre: F64
    normal: F64
    tangent: F64
    beta: F64
    inverse: F64


class SurfaceFilter:
    """See the module. Feed platform states and mapped points, ask for updates; order and batching do not matter."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters.filter
        self.beams = parameters.georeference.beams
        self._mount = mounting(parameters.calibration, parameters.georeference.pose_source)
        self._store = VoxelStore(self.parameters.radius_m, self.parameters.cap_per_voxel)
        self._states: PlatformStates | None = None
        self._waiting: list[MappedPoints] = []
        self._losses = Losses()
        self._published: Bool = np.zeros(0, np.bool_)
        self._outliers: I64 = np.zeros(0, np.int64)
        self._unfitted: I64 = np.zeros(0, np.int64)
        self._t_ns = 0

    @property
    def losses(self) -> Losses:
        """Points that reached no surface, by reason, for the surface as it stands now."""
        total = Losses(self._losses.as_dict())
        total.add("point_outlier", int(self._outliers.sum()))
        total.add("point_few_neighbours", int(self._unfitted.sum()))
        return total

    @property
    def stats(self) -> dict[str, int]:
        """Counts of the surface as it stands: voxels, points offered, kept, over the cap, and waiting for a pose."""
        return {
            "voxels": self._store.used,
            "points_offered": self._store.offered,
            "points_kept": self._store.kept,
            "points_over_cap": self._store.offered - self._store.kept,
            "patches": int(self._published.sum()),
            "points_waiting": sum(len(p) for p in self._waiting),
        }

    def add_platform(self, states: PlatformStates) -> None:
        """Poses along the path; points that waited for them are taken in."""
        self._states = states if self._states is None else concatenate([self._states, states])
        self._drain()

    def add(self, points: MappedPoints) -> None:
        """Mapped points; they wait until platform states enclose them."""
        if len(points):
            self._waiting.append(points)
            self._drain()

    def _drain(self) -> None:
        states = self._states
        if states is None or len(states) == 0:
            return
        newest = int(states.t_ns[-1])
        ready = [p for p in self._waiting if int(p.t_ns.max()) <= newest]
        self._waiting = [p for p in self._waiting if int(p.t_ns.max()) > newest]
        for points in ready:
            self._take_in(points, states)
        oldest = min([newest - KEEP_NS, *(int(p.t_ns.min()) - KEEP_NS for p in self._waiting)])
        if int(states.t_ns[0]) < oldest - KEEP_NS:
            self._states = select(states, slice(int(np.searchsorted(states.t_ns, oldest)), None))

    def _take_in(self, points: MappedPoints, states: PlatformStates) -> None:
        n = len(points)
        verdict, state, fraction = np.zeros(n, np.int8), np.zeros(n, np.int64), np.zeros(n)
        limit = (HALF - 8) * self.parameters.radius_m
        admission.admit(points.t_ns, points.r_map, points.C_ind, limit, states.t_ns, states.segment, verdict, state, fraction)
        counts = np.bincount(verdict, minlength=4)
        self._losses.add("point_nan", int(counts[admission.NOT_FINITE]))
        self._losses.add("point_too_far", int(counts[admission.TOO_FAR]))
        self._losses.add("point_platform_gap", int(counts[admission.UNCOVERED]))
        if counts[admission.TAKEN] < n:
            keep = verdict == admission.TAKEN
            points, state, fraction = select(points, keep), state[keep], fraction[keep]
        if len(points) == 0:
            return
        self._t_ns = max(self._t_ns, int(points.t_ns.max()))
        slots, rows = self._store.insert(points.t_ns, points.ring, points.r_map, points.C_ind)
        admission.geometry(
            rows, slots, points.r_map, state, fraction, states.p_map_body, states.q_map_body, states.v_body, states.omega_body,
            self._mount.lever_laser, self._mount.lever_antenna, self._store.aux,
        )  # fmt: skip

    def update(self) -> FilterUpdate | None:
        """What changed since the last update, or None."""
        return self._update(complete=False)

    def finish(self) -> FilterUpdate | None:
        """End of the data: points that still wait are lost and counted; the last update, or None where nothing changed."""
        self._losses.add("point_platform_gap", sum(len(p) for p in self._waiting))
        self._waiting = []
        return self._update(complete=True)

    def _update(self, complete: bool) -> FilterUpdate | None:
        changed = self._store.take_changed()
        if len(changed) == 0:
            return None
        grow = self._store.used - len(self._published)
        for name in ("_published", "_outliers", "_unfitted"):
            setattr(self, name, np.concatenate([getattr(self, name), np.zeros(grow, getattr(self, name).dtype)]))
        refitted = self._around(changed, REACH)
        rows_voxels = self._around(refitted, cross.SPAN)
        fits = self._fit(self._around(rows_voxels, cross.SPAN))
        mine = np.isin(fits.voxels, rows_voxels)
        good = fits.status == OK
        rows = np.flatnonzero(mine & good)
        gone = fits.voxels[mine & ~good]
        removed = self._store.keys[gone[self._published[gone]]]
        self._account(fits, mine)
        patches = self._patches(fits, rows)
        points = self._points(fits, rows, patches)
        self._published[gone] = False
        self._published[fits.voxels[rows]] = True
        return FilterUpdate(self._t_ns, np.sort(removed), points, patches, complete)

    def _around(self, voxels: I64, reach: int) -> I64:
        """Indices of all voxels within ``reach`` of the given ones, in order of their keys."""
        s = self._store
        if len(voxels) == s.used:
            chosen = voxels
        else:
            marked = np.zeros(len(s.keys), np.bool_)
            marked[voxels] = True
            near = np.zeros(s.used, np.bool_)
            kernels.near_marked(s.keys, s.used, s.table, marked, reach, near)
            chosen = np.flatnonzero(near)
        order: I64 = chosen[np.argsort(s.keys[chosen], kind="stable")]
        return order

    def _fit(self, voxels: I64) -> _Fits:
        s, f = self._store, self.parameters
        m, p = len(voxels), 6 if f.degree == 2 else 3
        bound = np.zeros(m, np.int64)
        kernels.count_candidates(voxels, s.keys, s.table, s.count, bound)
        start = np.concatenate([[0], np.cumsum(bound)])
        fits = _Fits(
            voxels, start, np.empty(start[-1], np.int64), np.zeros(m, np.int64), np.zeros(m, np.int64), np.zeros(m), np.zeros(m, np.int64),
            np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 3)), np.zeros((m, 6)), np.zeros((m, 6, 6)),
        )  # fmt: skip
        kernels.fit_patches(
            voxels, start, s.keys, s.table, s.count, s.order, s.r, s.t_ns, s.aux, s.cap, f.radius_m, p, f.sample_size or 4, f.trials,
            f.start == "ransac", f.ransac_threshold_m, f.outlier_sigmas, f.outlier_floor_m, f.min_points, f.refit_iterations, f.seed,
            fits.members, fits.status, fits.used, fits.sigma, fits.time, fits.centre, fits.normal, fits.tangent, fits.beta, fits.inverse,
        )  # fmt: skip
        return fits

    def _account(self, fits: _Fits, mine: Bool) -> None:
        """Keep, per voxel, how many of its points are outliers of their patch or have no patch."""
        voxels = fits.voxels[mine]
        held = self._store.count[voxels].astype(np.int64)
        failed = fits.status[mine] != OK
        self._unfitted[voxels] = np.where(failed, held, 0)
        self._outliers[voxels] = np.where(failed, 0, held)  # those projected are taken off in _points

    def _patches(self, fits: _Fits, rows: I64) -> Patches:
        s, p = self._store, 6 if self.parameters.degree == 2 else 3
        patch_of = np.full(s.used, -1, np.int64)
        good = np.flatnonzero(fits.status == OK)
        patch_of[fits.voxels[good]] = good
        offset, others = self._pairs(fits, rows, patch_of)
        blocks = np.zeros((offset[-1], p, p))
        most = int(fits.used.max(initial=0))
        cross.cross_blocks(
            rows, offset, others, fits.start, fits.used, fits.members, s.r, s.C, fits.centre, fits.normal, fits.tangent, fits.inverse, p,
            most, cross.chunks_of(len(rows)), blocks,
        )  # fmt: skip
        nav_start, nav_bin, M_cal, M_nav = self._sensitivities(fits, rows, p)
        return Patches(
            s.keys[fits.voxels[rows]], fits.centre[rows], fits.normal[rows], fits.tangent[rows], fits.beta[rows, :p], fits.sigma[rows],
            fits.used[rows].astype(np.int32), fits.time[rows], offset, s.keys[fits.voxels[others]], blocks, M_cal, nav_start, nav_bin,
            M_nav,
        )  # fmt: skip

    def _pairs(self, fits: _Fits, rows: I64, patch_of: I64) -> tuple[I64, I64]:
        """Pairs of patches that share raw points, in CSR form: (offset, other patch), the other's key never the lower one."""
        s, counts = self._store, np.zeros(len(rows), np.int64)

        def listed(fill: bool, offset: I64, out: I64) -> None:
            cross.candidates(
                rows, fits.voxels, patch_of, fits.centre, self.parameters.radius_m, s.keys, s.table, fill, offset, out, counts
            )  # fmt: skip

        listed(False, np.zeros(len(rows) + 1, np.int64), np.empty(0, np.int64))
        offset = np.concatenate([[0], np.cumsum(counts)])
        others = np.empty(offset[-1], np.int64)
        listed(True, offset, others)
        shared = np.zeros(len(others), np.bool_)
        cross.sharing(rows, offset, others, fits.start, fits.used, fits.members, len(s.r), cross.chunks_of(len(rows)), shared)
        return np.concatenate([[0], np.cumsum(shared)])[offset], others[shared]

    def _sensitivities(self, fits: _Fits, rows: I64, p: int) -> tuple[I64, I64, F64, F64]:
        s, bin_ns = self._store, np.int64(self.parameters.nav_bin_s * 1e9)
        start = np.concatenate([[0], np.cumsum(fits.used[rows])])
        members = _joined(fits.members, fits.start[rows], fits.used[rows])
        bins = np.zeros(len(rows), np.int64)
        sensitivity.count_bins(start, fits.used[rows], members, s.t_ns, bin_ns, bins)
        nav_start = np.concatenate([[0], np.cumsum(bins)])
        nav_bin = np.zeros(nav_start[-1], np.int64)
        M_cal = np.zeros((len(rows), p, 11 + 2 * self.beams))
        M_nav = np.zeros((nav_start[-1], p, 6))
        sensitivity.sensitivities(
            start, fits.used[rows], members, s.r, s.t_ns, s.ring, s.aux, fits.centre[rows], fits.normal[rows], fits.tangent[rows],
            fits.inverse[rows], p, self.beams, self._mount.lever_laser, self._mount.lever_antenna,
            np.ascontiguousarray(self._mount.R_body_laser[:, 2]), bin_ns, nav_start, nav_bin, M_cal, M_nav,
        )  # fmt: skip
        return nav_start, nav_bin, M_cal, M_nav

    def _points(self, fits: _Fits, rows: I64, patches: Patches) -> FilteredPoints:
        s, p = self._store, patches.beta.shape[1]
        n = len(rows) * s.cap
        r, normal, variance = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
        C, t_ns, uv = np.zeros((n, 6), np.float32), np.zeros(n, np.int64), np.zeros((n, 2))
        counts, own = np.zeros(len(rows), np.int64), np.zeros(len(rows), np.int64)
        spacing = self.parameters.sampling_m or self.parameters.radius_m / 2
        project.project(
            rows, fits.voxels, fits.start, fits.used, fits.members, s.r, s.C, s.t_ns, s.cap, fits.centre, fits.normal, fits.tangent,
            fits.beta, np.ascontiguousarray(patches.cross[patches.cross_start[:-1]]), p, spacing,
            r, normal, variance, C, t_ns, uv, counts, own,
        )  # fmt: skip
        self._outliers[fits.voxels[rows]] -= own
        slot = np.arange(n) % max(s.cap, 1)
        keep = slot < np.repeat(counts, s.cap)
        patch = np.repeat(patches.key, s.cap)
        return select(FilteredPoints(r, normal, variance, C, t_ns, patch, uv), keep)


def _joined(values: I64, start: I64, length: I64) -> I64:
    """The slices ``values[start[i]:start[i] + length[i]]`` one after another."""
    index = np.repeat(start - np.concatenate([[0], np.cumsum(length)[:-1]]) if len(start) else start, length)
    joined: I64 = values[index + np.arange(len(index))]
    return joined

"""The filter stage: robust moving least squares on a stream (seed 002 chapter 4; UNCERTAINTY steps
3 and 4).

Raw points go into capped voxels of edge r. Every occupied voxel has one patch, fitted over 2r; each
raw point is projected once, by the patch of its own voxel. An update refits what new points touched
and replaces the patches that are others then; one in a hurry puts off what new points would change
least.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.georeference.lidar_equation import mounting
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import (
    I64,
    Bool,
    FilterUpdate,
    MappedPoints,
    PlatformStates,
    concatenate,
    select,
)
from ladar_volume.rmls import point_admission, refit_kernels
from ladar_volume.rmls.deferral import WaitingPoints
from ladar_volume.rmls.fit_store import FitStore
from ladar_volume.rmls.patch_builder import PatchBuilder
from ladar_volume.rmls.patch_fit import FEW_POINTS, OK, REACH
from ladar_volume.rmls.viewing_geometry import NUMBERS, store_geometry
from ladar_volume.rmls.voxel_store import HALF, Candidates, VoxelStore

#: Platform states older than this before the newest are forgotten once no point waits for them.
KEEP_NS = 30_000_000_000
#: Voxels fitted at once: the neighbours looked at take room.
BLOCK = 4096


class SurfaceFilter:
    """See the module. Feed platform states and mapped points, ask for updates; order and batching
    do not matter.
    """

    def __init__(self, parameters: Parameters, deferring: bool = False) -> None:
        """deferring : new points are put into the surface by updates alone, which may put them
        off.
        """
        self.parameters = parameters.filter
        self._mount = mounting(parameters.calibration, parameters.georeference.pose_source)
        self._beams = parameters.georeference.beams
        self._empty()
        self.fits = FitStore(FEW_POINTS, self.parameters.cap_per_voxel)
        self._states: PlatformStates | None = None
        self._waiting: list[MappedPoints] = []
        self._losses = Losses()
        self._published: Bool = np.zeros(0, np.bool_)
        self._outliers: I64 = np.zeros(0, np.int64)
        self._unfitted: I64 = np.zeros(0, np.int64)
        self._t_ns = 0
        self._deferring = deferring
        self._deferred = WaitingPoints(self.parameters.cap_per_voxel)
        self._refitted = 0

    def _empty(self) -> None:
        self.store = VoxelStore(self.parameters.radius_m, self.parameters.cap_per_voxel)
        self.builder = PatchBuilder(self.parameters, self.store, self._mount, self._beams)

    @property
    def newest_ns(self) -> int:
        """Time of the newest point taken in, ns."""
        return self._t_ns

    def release_points(self) -> Candidates:
        """The points held, which are then no longer here, for a filter elsewhere
        (``tile_filter``). Not for a filter that has been asked for an update.
        """
        points, offered = self.store.points(), self.store.offered
        self._empty()
        self.store.offered = offered
        return points

    @property
    def losses(self) -> Losses:
        """Points that reached no surface, by reason, for the surface as it stands now."""
        total = Losses(self._losses.as_dict())
        total.add("point_outlier", int(self._outliers.sum()))
        total.add("point_few_neighbours", int(self._unfitted.sum()))
        return total

    @property
    def stats(self) -> dict[str, int]:
        """Counts of the surface as it stands: voxels, points offered, kept, over the cap, put off,
        and waiting for a pose.
        """
        return {
            "voxels": self.store.used,
            "points_offered": self.store.offered,
            "points_kept": self.store.kept_count,
            "points_over_cap": self.store.offered - self.store.kept_count - len(self._deferred),
            "patches": int(self._published.sum()),
            "points_deferred": len(self._deferred),
            "points_waiting": sum(len(p) for p in self._waiting),
        }

    @property
    def refitted_count(self) -> int:
        """Voxels fitted in the last update that had any to fit."""
        return self._refitted

    @property
    def deferred_s(self) -> float:
        """How much older than the newest point the oldest one is that waits for its voxel's turn,
        s.
        """
        return self._deferred.age_s(self._t_ns)

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
        verdict = np.zeros(n, np.int8)
        at = point_admission.Bracket(np.zeros(n, np.int64), np.zeros(n))
        limit = (HALF - 8) * self.parameters.radius_m
        point_admission.admit(
            points.t_ns,
            points.r_map,
            points.C_ind,
            limit,
            states.t_ns,
            states.segment,
            verdict,
            at,
        )
        counts = np.bincount(verdict, minlength=4)
        self._losses.add("point_nan", int(counts[point_admission.NOT_FINITE]))
        self._losses.add("point_too_far", int(counts[point_admission.TOO_FAR]))
        self._losses.add("point_platform_gap", int(counts[point_admission.UNCOVERED]))
        if counts[point_admission.TAKEN] < n:
            keep = verdict == point_admission.TAKEN
            points = select(points, keep)
            at = point_admission.Bracket(at.state[keep], at.fraction[keep])
        if len(points) == 0:
            return
        self._t_ns = max(self._t_ns, int(points.t_ns.max()))
        candidates, rows = self.store.offer(points.t_ns, points.ring, points.r_map, points.C_ind)
        seen = np.empty((len(rows), NUMBERS))
        moving = point_admission.StateArrays(
            states.p_map_body, states.q_map_body, states.v_body, states.omega_body
        )
        point_admission.geometry(rows, points.r_map, at, moving, self._mount.lever_laser, seen)
        store_geometry(seen, candidates.aux)
        if self._deferring:
            self._deferred.add(candidates)
        else:
            self.store.insert(candidates)

    def update(self, most: int | None = None) -> FilterUpdate | None:
        """What changed since the last update, or None.

        most : patches to be refitted, about, where the filter is deferring: then points wait whose
        voxels change least (see ``deferral``), and the surface is that of the points taken in so
        far. Without it nothing waits: the surface is that of all points.
        """
        if self._deferring:
            self.store.insert(self._deferred.take(self.store, most, self._t_ns))
        return self._update()

    def finish(self) -> FilterUpdate | None:
        """End of the data: points that still wait for a pose are lost and counted; the last update,
        or None where nothing changed.
        """
        self.finish_points()
        return self.update()

    def finish_points(self) -> None:
        """End of the data: points that still wait for a pose are lost and counted."""
        self._losses.add("point_platform_gap", sum(len(p) for p in self._waiting))
        self._waiting = []

    def _update(self) -> FilterUpdate | None:
        s = self.store
        changed = s.changed_voxels()
        if len(changed) == 0:
            return None
        touched = self.dependent_voxels(changed)
        self._refitted = len(touched)
        new = self._refit(touched)
        s.settle()
        good = self.fits.fits.status[new] == OK
        rows, gone = new[good], new[~good]
        removed = s.keys[gone[self._published[gone]]]
        self._published[gone], self._published[rows] = False, True
        patches = self.builder.patches(self.fits, rows)
        return FilterUpdate(
            self._t_ns, np.sort(removed), self.builder.points(self.fits, rows, patches), patches
        )

    def _refit(self, voxels: I64) -> I64:
        """Fit these voxels, in order of their keys; returns those whose patch is another one now,
        in that order.
        """
        s, new = self.store, np.zeros(len(voxels), np.bool_)
        grow = s.used - len(self._published)
        for name in ("_published", "_outliers", "_unfitted"):
            setattr(
                self,
                name,
                np.concatenate([getattr(self, name), np.zeros(grow, getattr(self, name).dtype)]),
            )
        self.fits.grow(s.used)
        for i in range(0, len(voxels), BLOCK):
            block = voxels[i : i + BLOCK]
            found = self.builder.fit(block)
            new[i : i + BLOCK], own = self.fits.keep(found, s.fresh)
            held, failed = s.count[block].astype(np.int64), found.status != OK
            self._unfitted[block] = np.where(failed, held, 0)
            self._outliers[block] = np.where(failed, 0, held - own)
        return voxels[new]

    def dependent_voxels(self, voxels: I64) -> I64:
        """Indices of all voxels whose patch looks at one of these, in order of their keys."""
        s = self.store
        near = np.zeros(s.used, np.bool_)
        refit_kernels.mark_around(voxels, s.keys, s.table, REACH, near)
        chosen = np.flatnonzero(near)
        order: I64 = chosen[np.argsort(s.keys[chosen], kind="stable")]
        return order

"""Patches of a set of voxels: fits, cross blocks, sensitivities and projected points, assembled
from the kernels.
"""

from __future__ import annotations

import numpy as np

from ladar_volume.georeference.lidar_equation import Mounting
from ladar_volume.math.array_types import F32
from ladar_volume.math.kernels import run_in_threads
from ladar_volume.model.parameters import SurfaceFilterParameters
from ladar_volume.model.records import I64, FilteredPoints, Patches, select
from ladar_volume.rmls import cross_covariance, patch_sensitivity, projection, refit_kernels
from ladar_volume.rmls.fit_store import Fits, FitStore, blank_fits
from ladar_volume.rmls.patch_fit import OK
from ladar_volume.rmls.voxel_store import VoxelStore


class PatchBuilder:
    """Fits the voxels of a store and assembles what is published. Holds no state of its own."""

    def __init__(
        self, parameters: SurfaceFilterParameters, store: VoxelStore, mount: Mounting, beams: int
    ) -> None:
        self.parameters, self.store, self.mount, self.beams = parameters, store, mount, beams
        self.most_bins = patch_sensitivity.MOST_BINS

    def fit(self, voxels: I64) -> Fits:
        """Fit the patches of these voxels (indices)."""
        s, f = self.store, self.parameters
        p, bound = 6 if f.degree == 2 else 3, np.zeros(len(voxels), np.int64)
        refit_kernels.count_candidates(voxels, s.arrays, bound)
        start = np.concatenate([[0], np.cumsum(bound)])
        fits = blank_fits(voxels, start, np.empty(start[-1], np.int32))
        rule = refit_kernels.FitRule(
            f.radius_m,
            p,
            f.sample_size,
            f.trials,
            f.start == "ransac",
            f.ransac_threshold_m,
            f.outlier_sigmas,
            f.outlier_floor_m,
            f.min_points,
            f.refit_iterations,
            f.seed,
        )
        run_in_threads(refit_kernels.fit_patches, np.arange(len(voxels)), s.arrays, rule, fits)
        return fits

    def patches(self, kept: FitStore, rows: I64, once: bool = False) -> Patches:
        """The record of patches ``rows`` of the fits of all voxels; pairs with a patch of a lower
        key are listed, after the others, where that patch is not among the rows; with ``once`` they
        are not: they are listed with that patch, wherever that is.
        """
        s, p = self.store, 6 if self.parameters.degree == 2 else 3
        offset, others = self._pairs(kept, rows, once)
        fits = kept.with_inliers(np.union1d(rows, others), s)
        blocks = self._cross_blocks(fits, cross_covariance.Pairs(rows, offset, others), p)
        found = self._sensitivities(fits, rows, p)
        return Patches(
            s.keys[rows],
            fits.centre[rows],
            fits.normal[rows],
            fits.tangent[rows],
            fits.beta[rows, :p],
            fits.sigma[rows],
            fits.used[rows].astype(np.int32),
            fits.time[rows],
            offset,
            s.keys[others],
            blocks,
            found.M_cal,
            found.nav_start,
            found.nav_bin,
            found.M_nav,
            nav_residual=found.nav_residual,
            beam_residual=found.beam_residual,
            own_residual=found.own_residual,
        )

    def _cross_blocks(self, fits: Fits, pairs: cross_covariance.Pairs, p: int) -> F32:
        s, chunks = self.store, cross_covariance.chunks_of(len(pairs.rows))
        blocks = np.zeros((len(pairs.others), p, p), np.float32)
        slots = cross_covariance.local_slots(fits.members, s.cap, s.used)
        run_in_threads(
            cross_covariance.cross_blocks,
            np.arange(chunks),
            pairs,
            s.arrays,
            fits,
            slots,
            p,
            chunks,
            blocks,
        )
        return blocks

    def _pairs(self, kept: FitStore, rows: I64, once: bool) -> tuple[I64, I64]:
        """Pairs of patches that share raw points, in CSR form: (offset, other patch)."""
        fits = kept.fits
        s, counts, mine = (
            self.store,
            np.zeros(len(rows), np.int64),
            np.full(len(fits.voxels), once),
        )
        mine[rows] = True
        balls = cross_covariance.Balls(
            fits.status == OK, mine, fits.centre, self.parameters.radius_m
        )

        def list_inliers(fill: bool, offset: I64, out: I64) -> None:
            cross_covariance.candidates(
                cross_covariance.Pairs(rows, offset, out), balls, s.arrays, fill, counts
            )

        list_inliers(False, np.zeros(len(rows) + 1, np.int64), np.empty(0, np.int64))
        offset = np.concatenate([[0], np.cumsum(counts)])
        others = np.empty(offset[-1], np.int64)
        list_inliers(True, offset, others)
        shared = np.zeros(len(others), np.bool_)
        cross_covariance.pairs_sharing_inliers(
            cross_covariance.Pairs(rows, offset, others),
            kept.first,
            kept.held,
            kept.entries,
            len(fits.voxels),
            cross_covariance.chunks_of(len(rows)),
            shared,
        )
        return np.concatenate([[0], np.cumsum(shared)])[offset], others[shared]

    def _sensitivities(self, fits: Fits, rows: I64, p: int) -> patch_sensitivity.SensitivityArrays:
        s, bin_ns = self.store, int(self.parameters.nav_bin_s * 1e9)
        bins = np.zeros(len(rows), np.int64)
        patch_sensitivity.count_bins(rows, fits, s.t_ns, bin_ns, self.most_bins, bins)
        nav_start = np.concatenate([[0], np.cumsum(bins)])
        mount = patch_sensitivity.MountArrays(
            self.mount.lever_laser - self.mount.lever_antenna,
            np.ascontiguousarray(self.mount.R_body_laser[:, 2]),
            self.beams,
            bin_ns,
        )
        out = patch_sensitivity.SensitivityArrays(
            nav_start,
            np.zeros(nav_start[-1], np.int64),
            np.zeros((len(rows), p + 2, 11 + 2 * self.beams), np.float32),
            np.zeros((nav_start[-1], p + 2, 4), np.float32),
            np.zeros(nav_start[-1], np.float32),
            np.zeros((len(rows), self.beams), np.float32),
            np.zeros(len(rows), np.float32),
        )
        run_in_threads(
            patch_sensitivity.sensitivities,
            np.arange(len(rows)),
            rows,
            s.arrays,
            fits,
            p,
            mount,
            out,
        )
        return out

    def points(self, kept: FitStore, rows: I64, patches: Patches) -> FilteredPoints:
        """The filtered points of patches ``rows``."""
        s, p, fits = self.store, patches.beta.shape[1], kept.with_inliers(rows, self.store)
        n = len(rows) * s.cap
        out = projection.ProjectedArrays(
            np.zeros((n, 3)),
            np.zeros((n, 3)),
            np.zeros(n),
            np.zeros((n, 6), np.float32),
            np.zeros(n, np.int64),
            np.zeros((n, 2)),
            np.zeros(len(rows), np.int64),
        )
        spacing = self.parameters.sampling_m or self.parameters.radius_m / 2
        C_beta = np.ascontiguousarray(patches.cross[patches.cross_start[:-1]])
        run_in_threads(
            projection.project,
            np.arange(len(rows)),
            rows,
            s.arrays,
            fits,
            C_beta,
            p,
            spacing,
            out,
        )
        slot = np.arange(n) % max(s.cap, 1)
        keep = slot < np.repeat(out.counts, s.cap)
        patch = np.repeat(patches.key, s.cap)
        return select(
            FilteredPoints(out.r, out.normal, out.variance, out.C, out.t_ns, patch, out.uv), keep
        )

"""The large parts of a held surface in few bits: covariance blocks in 8, sensitivities to the
navigation and to single beams in 16.

*Blocks.* Between parameters as they are, correlations would not do: those of one patch depend on
    one another, and what a result takes of
them may be a small difference. So each patch has a factor ``F F^T = C_aa`` of its own block
    (Cholesky), and ``R_ab = F_a^-1 C_ab F_b^-T``
is kept: correlations of parameters made independent within their patch, none beyond 1, to 1/254.
    With the loads ``y_a = F_a^T q_a``, whose
squares add up to the variance if patches shared no returns, the variance errs by no more than
    ``(sum |y_a|_1)^2 / 254`` over pairs with a
block, in truth by far less, since the errors have either sign.

*Sensitivities.* Each row of a patch has a unit of its own for position and for attitude, for the
    beams' ranges and for their vertical
angles: 2^-15 of its largest number there. Those to what all beams share stay float32: there is one
    of each, and in its sum over body and
ground what is the same for both cancels.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.math.kernels import kernel
from ladar_volume.math.large_arrays import large_zeros
from ladar_volume.model.ragged_ranges import patch_range
from ladar_volume.model.records import (
    CAL_COLUMNS,
    F32,
    F64,
    I8,
    I16,
    I32,
    I64,
    HeldPatches,
    Patches,
    PatchTable,
)
from ladar_volume.uncertainty.load_kernels import BinRows
from ladar_volume.uncertainty.patch_merge import has_key, place_from

#: Whole number for a correlation of 1, and what the factors are kept times: then a block is ``F_a R
#: F_b^T`` of whole numbers R.
ONE = 127.0
SCALE = ONE**-0.5
#: A pivot below this share of its diagonal is raised to it: there the block's own digits end.
PIVOT = 1e-6
#: Largest whole number of a sensitivity.
LARGEST = 32767.0
#: Calibration columns that all beams share; those of their ranges and of their vertical angles
#: follow.
SHARED = len(CAL_COLUMNS)


@kernel
def factor_kernel(key: I64, start: I64, other: I64, cross: F32) -> F32:
    """Lower factors (m, p, p), times :data:`SCALE`, of the own blocks of patches key (m,), among
    those from start (m + 1,) on, each with the patch ``other``; zero where a parameter is certain,
    or where there is no such block.
    """
    m, p = len(key), cross.shape[1]
    out, L = np.zeros((m, p, p), np.float32), np.zeros((p, p))
    for a in range(m):
        at = start[a]
        while at < start[a + 1] and other[at] != key[a]:
            at += 1
        if at == start[a + 1]:
            continue
        C = cross[at]
        L[:] = 0.0
        for j in range(p):
            s = np.float64(C[j, j])
            if not s > 0.0:
                continue
            least = PIVOT * s
            for k in range(j):
                s -= L[j, k] * L[j, k]
            L[j, j] = np.sqrt(max(s, least))
            for i in range(j + 1, p):
                s = np.float64(C[i, j])
                for k in range(j):
                    s -= L[i, k] * L[j, k]
                L[i, j] = s / L[j, j]
        for i in range(p):
            for j in range(i + 1):
                out[a, i, j] = L[i, j] * SCALE
    return out


@kernel
def solve_left(F: F32, T: F64) -> None:
    """``F^-1 T`` in place, for a lower F (p, p) and T (p, p); zero where a diagonal of F is."""
    p = len(F)
    for i in range(p):
        for c in range(p):
            s = T[i, c]
            for k in range(i):
                s -= F[i, k] * T[k, c]
            T[i, c] = s / F[i, i] if F[i, i] > 0.0 else 0.0


@kernel
def block_kernel(own: I64, start: I64, other: I64, cross: F32, keys: I64, factor: F32) -> I8:
    """Blocks (k, p, p) of one part as whole numbers: own (m,) its keys, start, other in CSR form;
    zero where one of the two patches is not among ascending keys with their factors. The lower key
    comes first.
    """
    p, at, hint = cross.shape[1], 0, 0
    out, T, U = np.zeros(cross.shape, np.int8), np.empty((p, p)), np.empty((p, p))
    for i in range(len(own)):
        at, hint = place_from(keys, own[i], at), 0
        for e in range(start[i], start[i + 1]):
            hint = place_from(keys, other[e], hint)
            if not has_key(keys, own[i], at) or not has_key(keys, other[e], hint):
                continue
            a, b = min(at, hint), max(at, hint)
            for r in range(p):
                for c in range(p):
                    T[r, c] = cross[e, r, c]
            solve_left(factor[a], T)
            for r in range(p):
                for c in range(p):
                    U[r, c] = T[c, r]
            solve_left(factor[b], U)
            for r in range(p):
                for c in range(p):
                    out[e, r, c] = np.int8(np.rint(min(max(U[c, r], -ONE), ONE)))
    return out


@kernel
def row_kernel(start: I64, M: F32) -> tuple[I16, F32]:
    """Sensitivities M (l, rows, 4), those of each of m patches from start (m + 1,) on, as whole
    numbers (l, rows, 4), and the units (m, rows, 2) of each row for position and attitude.
    """
    rows, m = M.shape[1], len(start) - 1
    out, unit = np.zeros(M.shape, np.int16), np.zeros((m, rows, 2), np.float32)
    for a in range(m):
        for r in range(rows):
            for e in range(start[a], start[a + 1]):
                for c in range(4):
                    unit[a, r, min(c, 1)] = max(unit[a, r, min(c, 1)], abs(M[e, r, c]))
            unit[a, r] /= np.float32(LARGEST)
            for e in range(start[a], start[a + 1]):
                for c in range(4):
                    if unit[a, r, min(c, 1)] > 0.0:
                        out[e, r, c] = np.int16(np.rint(M[e, r, c] / unit[a, r, min(c, 1)]))
    return out, unit


@kernel
def beam_kernel(M: F32) -> tuple[I16, F32]:
    """Sensitivities M (m, rows, 2 beams) to the range of each beam, then to its vertical angle, as
    whole numbers, and the units (m, rows, 2) of each row for both.
    """
    m, rows, beams = M.shape[0], M.shape[1], M.shape[2] // 2
    out, unit = np.zeros(M.shape, np.int16), np.zeros((m, rows, 2), np.float32)
    for a in range(m):
        for r in range(rows):
            for h in range(2):
                largest = np.float32(0.0)
                for c in range(h * beams, (h + 1) * beams):
                    largest = max(largest, abs(M[a, r, c]))
                if largest > 0.0:
                    unit[a, r, h] = largest / np.float32(LARGEST)
                    for c in range(h * beams, (h + 1) * beams):
                        out[a, r, c] = np.int16(np.rint(M[a, r, c] / unit[a, r, h]))
    return out, unit


def factor_loads(q: F64, patches: PatchTable, columns: int = 0) -> F64:
    """Loads (m, p, k or ``columns``) on that whose covariances the blocks are, of loads q (m, p or
    more, k) of which the first p are on the patches' parameters; zero in columns beyond k.
    """
    p = patches.beta.shape[1]
    out: F64 = large_zeros((len(q), p, max(columns, q.shape[2])))
    if isinstance(patches, HeldPatches):
        factor_load_kernel(patches.factor, q, out)
    else:
        out[:, :, : q.shape[2]] = q[:, :p]
    return out


@kernel
def factor_load_kernel(factor: F32, q: F64, out: F64) -> None:
    """Adds ``Lᵀ q`` of lower triangles L (m, p, p) and loads q (m, p or more, k) to out (m, p, k or
    more).
    """
    m, p, results = len(factor), factor.shape[1], q.shape[2]
    for a in range(m):
        for r in range(p):
            for k in range(results):
                if q[a, r, k] != 0.0:  # most patches are in no volume
                    for s in range(r + 1):
                        out[a, s, k] += factor[a, r, s] * q[a, r, k]


def factor_rows(X: F64, row: I64, patches: PatchTable) -> F64:
    """The same for design rows X (n, p) of points on patches row (n,), in their place."""
    if isinstance(patches, HeldPatches):
        factor_row_kernel(patches.factor, X, row)
    return X


@kernel
def factor_row_kernel(factor: F32, X: F64, row: I64) -> None:
    """``Lᵀ x`` in place of rows x (n, p), for lower triangles L (m, p, p), each with that of its
    patch row (n,).
    """
    for i in range(len(X)):
        for s in range(X.shape[1]):
            total = 0.0
            for r in range(s, X.shape[1]):  # those before are done with
                total += factor[row[i], r, s] * X[i, r]
            X[i, s] = total


def navigation_units(patches: PatchTable) -> F32:
    """Units (m, p + 2, 2) of the sensitivities to position and attitude."""
    if isinstance(patches, HeldPatches):
        return patches.nav_unit
    return np.ones((len(patches), patches.M_nav.shape[1], 2), np.float32)


def bin_rows(patches: PatchTable, bins: I32) -> BinRows:
    """The patches' sensitivities to the navigation, for kernels. bins : (l,) time bin of each."""
    p = patches
    return BinRows(p.nav_start, bins, p.M_nav, navigation_units(p), p.normal, p.tangent)


def calibration_parts(patches: PatchTable) -> tuple[F32, F32 | I16, F32]:
    """Sensitivities (m, p + 2, 11) to what all beams share, those (m, p + 2, 2 beams) to the range
    of each beam, then to its vertical angle, and the units (m, p + 2, 2) of each row for both.
    """
    if isinstance(patches, HeldPatches):
        return patches.M_cal, patches.M_beam, patches.beam_unit
    M = patches.M_cal
    return (
        np.ascontiguousarray(M[..., :SHARED]),
        np.ascontiguousarray(M[..., SHARED:]),
        np.ones((*M.shape[:2], 2), np.float32),
    )


def calibration_rows(patches: PatchTable, rows: I64 | slice, first: int | None = None) -> F32:
    """Sensitivities (k, p + 2, 11 + 2 beams) of patches ``rows`` (k,) as they are sent; only the
    ``first`` of each, where asked for.
    """
    if not isinstance(patches, HeldPatches):
        return patches.M_cal[rows, :first]
    unit = np.repeat(patches.beam_unit[rows, :first], patches.M_beam.shape[2] // 2, axis=2)
    return np.concatenate(
        [patches.M_cal[rows, :first], patches.M_beam[rows, :first] * unit], axis=2
    )


def beam_count(patches: PatchTable) -> int:
    """Beams that the patches have sensitivities to."""
    return (
        int(
            patches.M_beam.shape[2]
            if isinstance(patches, HeldPatches)
            else patches.M_cal.shape[2] - SHARED
        )
        // 2
    )


def prepare_patches(patches: Patches) -> HeldPatches:
    """Patches as they were sent, ready to be held but for their blocks: those wait until the
    factors of all patches are known.
    """
    rows = {f.name: getattr(patches, f.name) for f in dataclasses.fields(Patches)}
    if not len(patches.nav_residual):
        rows["nav_residual"] = np.full(len(patches.nav_bin), np.nan, np.float32)
        rows["beam_residual"] = np.full(
            (len(patches), max(0, beam_count(patches))), np.nan, np.float32
        )
    if not len(patches.own_residual):
        rows["own_residual"] = np.zeros(len(patches), np.float32)
    rows["M_nav"], rows["nav_unit"] = row_kernel(patches.nav_start, patches.M_nav)
    rows["M_cal"] = np.ascontiguousarray(patches.M_cal[..., :SHARED])
    rows["M_beam"], rows["beam_unit"] = beam_kernel(
        np.ascontiguousarray(patches.M_cal[..., SHARED:])
    )
    return HeldPatches(
        **rows,
        factor=np.asarray(
            factor_kernel(patches.key, patches.cross_start, patches.cross_key, patches.cross)
        ),
    )


def unpack_patches(patches: PatchTable, first: int, last: int) -> Patches:
    """Patches from ``first`` to ``last``, with blocks and sensitivities as they are sent."""
    rows = patch_range(patches, first, last)
    if not isinstance(patches, HeldPatches):
        return Patches(**rows)
    left = np.repeat(np.arange(first, last), np.diff(rows["cross_start"]))
    right = np.minimum(np.searchsorted(patches.key, rows["cross_key"]), len(patches) - 1)
    F = patches.factor
    rows["cross"] = np.einsum(
        "brs,bst,but->bru", F[left].astype(np.float64), rows["cross"], F[right], optimize=True
    ).astype(np.float32)
    unit = np.repeat(
        np.repeat(patches.nav_unit[first:last], np.diff(rows["nav_start"]), axis=0), (1, 3), axis=2
    )
    rows["M_nav"] = (rows["M_nav"] * unit.astype(np.float64)).astype(np.float32)
    rows["M_cal"] = calibration_rows(patches, slice(first, last))
    return Patches(**rows)

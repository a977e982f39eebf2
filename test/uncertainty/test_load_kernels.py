"""The kernels of the propagation against whole-array sums, and time bins and neighbours against
searches.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from random_surfaces import COLUMNS, random_surface
from volume_surfaces import by_position_and_attitude

from ladar_volume.math.packed_covariance import unpack
from ladar_volume.model.records import PlatformStates
from ladar_volume.uncertainty import propagation
from ladar_volume.uncertainty.load_kernels import (
    CalibrationRows,
    Entries,
    cell_kernel,
    correlated_kernel,
    deviation_kernel,
    height_kernel,
    naive_kernel,
    neighbour_rows,
    pair_falls_kernel,
    quadratic_kernel,
    shared_kernel,
)
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.packing import bin_rows, calibration_parts
from ladar_volume.uncertainty.propagation import (
    design_rows,
    independent_covariance,
    navigation_sensitivity,
    patch_loads,
    surface_geometry,
    time_bins,
)
from ladar_volume.uncertainty.second_order import STEEPEST, curvatures
from ladar_volume.uncertainty.volume_budget import upper_product


def close(value):
    return pytest.approx(value, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize("p,results", [(3, 3), (6, 3), (6, 7)])
def test_loads_and_their_pairs(p, results):
    points, patches, _, _ = random_surface(p, seed=3)
    geometry, g = (
        surface_geometry(points, patches),
        np.random.default_rng(4).standard_normal((len(points), results, 3)),
    )
    g[::3] = 0.0
    for c in range(3):  # along one axis alone, up and down
        for sign, first in ((1.0, 1 + 3 * c), (-1.0, 2 + 3 * c)):
            g[first::12] = sign * np.abs(g[first::12, :, :1]) * np.eye(3)[c]
    q = patch_loads(g, patches, geometry)
    n, t, X = (
        patches.normal[geometry.row],
        patches.tangent[geometry.row],
        design_rows(points.local, p),
    )
    along, twin = (
        [np.einsum("nkc,nc->nk", g, axis) for axis in (n, t, np.cross(n, t))],
        np.zeros_like(q),
    )
    np.add.at(
        twin,
        geometry.row,
        np.concatenate([X[:, :, None] * along[0][:, None], np.stack(along[1:], axis=1)], axis=1),
    )
    assert q == close(twin)
    q[2] = 0.0
    left, right = q[geometry.block_rows, :p], q[geometry.right, :p]
    half = np.einsum(
        "npa,npq,nqb,n->ab",
        left,
        patches.cross,
        right,
        np.where(geometry.block_rows == geometry.right, 1.0, 2.0),
    )
    assert independent_covariance(q, patches, geometry) == close(0.5 * (half + half.T))
    packed = points.C_tangent.astype(np.float64)
    assert quadratic_kernel(g[:, 1], points.C_tangent) == close(
        np.einsum("ni,nij,nj->", g[:, 1], unpack(packed), g[:, 1])
    )


def test_neighbours_are_found_whatever_their_order():
    rng = np.random.default_rng(5)
    key = np.sort(rng.choice(500, 60, replace=False)).astype(np.int64)
    start = np.concatenate([[0], np.cumsum(rng.integers(0, 9, 60))])
    cross_key = rng.integers(0, 700, start[-1])
    cross_key[start[:-1][np.diff(start) > 0]] = key[np.diff(start) > 0]  # own block first
    row = neighbour_rows(key, start, cross_key)
    known = np.isin(cross_key, key)
    assert 0 < known.sum() < len(known) and np.array_equal(row >= 0, known)
    assert np.array_equal(key[row[known]], cross_key[known])
    assert len(neighbour_rows(key[:1], np.zeros(2, np.int64), np.zeros(0, np.int64))) == 0


def test_time_bins(monkeypatch):
    _, patches, _, _ = random_surface(seed=6)
    for far in (0, 1 << 30):
        spread = dataclasses.replace(
            patches, nav_bin=patches.nav_bin * 7 - 3 + np.where(patches.nav_bin > 3, far, 0)
        )
        bins, index = time_bins(spread)
        assert np.array_equal(bins, np.unique(spread.nav_bin)) and np.array_equal(
            bins[index], spread.nav_bin
        )
        monkeypatch.setattr(propagation, "LONGEST", -1)  # by a search
        assert all(
            np.array_equal(a, b) for a, b in zip((bins, index), time_bins(spread), strict=True)
        )
        monkeypatch.undo()
    none = dataclasses.replace(patches, nav_bin=patches.nav_bin[:0])
    assert [len(part) for part in time_bins(none)] == [0, 0]


@pytest.mark.parametrize("p", [3, 6])
def test_what_is_shared(p):
    points, patches, _, _ = random_surface(p, seed=7)
    rng, m = np.random.default_rng(8), len(patches)
    bins, index = time_bins(patches)
    owner = np.repeat(np.arange(m), np.diff(patches.nav_start))
    P, A = rng.standard_normal((2, len(bins), 3, 3))
    M_nav = by_position_and_attitude(patches)
    rows = np.concatenate([M_nav[:, :p, :3] @ P[index], M_nav[:, :p, 3:] @ A[index]], axis=2)
    twin = np.zeros((m, p, 6))
    np.add.at(twin, owner, rows)
    every, deviation = np.arange(m), np.full((m, p, 6), np.nan)
    for part in (every[::2], every[1::2]):
        deviation_kernel(part, bin_rows(patches, index), P, A, deviation)
    assert deviation == close(twin)
    root = rng.standard_normal((COLUMNS, COLUMNS)) * (rng.random((COLUMNS, COLUMNS)) < 0.1)
    C = root @ root.T
    one, two = np.nonzero(C)
    entries = Entries(one, two, C[one, two])
    shared = np.full((m, p, p), np.nan)
    for part in (every[::2], every[1::2]):
        shared_kernel(
            part, CalibrationRows(*calibration_parts(patches)), entries, deviation, shared
        )
    assert shared == close(
        patches.M_cal[:, :p] @ C @ np.swapaxes(patches.M_cal[:, :p], 1, 2)
        + deviation @ np.swapaxes(deviation, 1, 2)
    )
    geometry = surface_geometry(points, patches)
    some = rng.permutation(len(points))[:9]
    X = design_rows(points.local, p)
    assert geometry.design(some).tobytes() == X[some].tobytes()
    assert height_kernel(X[some], geometry.row[some], shared) == close(
        np.einsum("np,npq,nq->n", X, shared[geometry.row], X)[some]
    )
    g = rng.standard_normal((len(points), 3)) * (rng.random((len(points), 1)) < 0.5)
    which, square = naive_kernel(g, patches.normal, geometry.row)
    assert np.array_equal(which, np.flatnonzero(g.any(axis=1)))
    assert square == close((g * patches.normal[geometry.row]).sum(axis=1)[which] ** 2)
    q = rng.standard_normal((m, p + 2))
    q[1] = 0.0
    J, used = navigation_sensitivity(q, patches)
    every = np.zeros((len(bins), 6))
    np.add.at(every, index, np.einsum("lp,lpc->lc", q[owner], M_nav))
    assert J == close(every[np.isin(bins, used)]) and not every[~np.isin(bins, used)].any()


def test_sums_by_cell():
    points, patches, _, _ = random_surface(6, seed=9)
    rng, m = np.random.default_rng(10), len(patches)
    bins, index = time_bins(patches)
    q, cell = rng.standard_normal((m, 8)), rng.integers(0, 4, m)
    cell[cell == 2] = 1  # a cell without patches
    q[cell == 3] = 0.0  # and one without loads
    found = cell_kernel(
        q,
        bin_rows(patches, index),
        np.argsort(cell, kind="stable"),
        cell,
        4,
        len(bins),
    )
    owner, twin = np.repeat(np.arange(m), np.diff(patches.nav_start)), np.zeros((4 * len(bins), 6))
    np.add.at(
        twin,
        cell[owner] * len(bins) + index,
        np.einsum("lp,lpc->lc", q[owner], by_position_and_attitude(patches)),
    )
    used = np.unique((cell[owner] * len(bins) + index)[cell[owner] != 3])
    assert np.array_equal(found[0], np.searchsorted(used, np.arange(5) * len(bins)))
    assert np.array_equal(found[1], used % len(bins)) and found[2] == close(twin[used])
    geometry = surface_geometry(points, patches)
    whole = independent_covariance(q[:, :, None], patches, geometry)
    falls = pair_falls_kernel(
        q, geometry.start, geometry.right, patches.cross, np.zeros(m, np.int64), 1
    )
    assert falls == close(0.5 * whole.ravel())  # all in one cell: half of the variance


def curvature_twin(q, patches, known):
    """H by whole arrays: every term for every sensitivity, those of a pass by its number."""
    owner = np.repeat(np.arange(len(patches)), np.diff(patches.nav_start))
    bins, M, n, load = (
        patches.nav_bin,
        by_position_and_attitude(patches),
        patches.normal[owner],
        q[owner, 0],
    )
    label = np.concatenate([[0], np.cumsum((owner[1:] != owner[:-1]) | (bins[1:] > bins[:-1] + 1))])
    position, R = known.mean_pose(bins)
    part = np.einsum("kc,kc->k", M[:, 0, :3], n)
    share, weight = load * part, np.abs(part) + 1e-12
    m, v = (np.einsum("kji,kj->ki", R, x) for x in (n, patches.centre[owner] - position))
    upright = np.copysign(np.maximum(np.abs(n[:, 2]), STEEPEST), n[:, 2])
    half = 0.5 * np.einsum("k,ki,kj->ij", share, m, v)
    for number, along in enumerate(
        (patches.tangent[owner], np.cross(n, patches.tangent[owner])), start=1
    ):
        body = np.einsum("kji,kj->ki", R, along)
        shift, standing = (
            np.cross(v, body) - (along[:, 2] / upright)[:, None] * np.cross(v, m),
            np.cross(body, m),
        )
        moving, mean = np.zeros((2, label[-1] + 1, 3))
        np.add.at(moving, label, load[:, None] * (M[:, number, 3:] - part[:, None] * standing))
        np.add.at(mean, label, weight[:, None] * shift)
        mean /= np.bincount(label, weight)[:, None]
        half -= np.einsum("k,ki,kj->ij", share, shift, standing) + mean.T @ moving
    up = np.copysign(np.maximum(np.abs(patches.normal[:, 2]), STEEPEST), patches.normal[:, 2])
    mean = np.average(-patches.normal / up[:, None], axis=0, weights=np.abs(q[:, 0] * up))
    slope = (-n / upright[:, None] - mean) * [1.0, 1.0, 0.0]
    turns = np.swapaxes(R, 1, 2)  # the body's axes in the map
    shift = np.cross(turns, (patches.centre[owner] - position)[:, None])
    change = np.cross(turns, [0.0, 0.0, 1.0])
    half -= np.einsum("k,kic,kc,kjd,kd->ij", share * upright, change, slope, shift, slope)
    return half + half.T - float(share @ np.einsum("kc,kc->k", m, v)) * np.eye(3)


@pytest.mark.parametrize("p", [3, 6])
def test_the_curvature(p):
    _, patches, _, _ = random_surface(p, m=30, seed=9)
    rng = np.random.default_rng(10)
    tangent = np.cross(patches.normal, rng.standard_normal((30, 3)))
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    patches = dataclasses.replace(patches, tangent=tangent, beta=rng.standard_normal((30, p)))
    known, t = NavigationBins(1.0), np.arange(70, dtype=np.int64) * 100_000_000
    turn = np.repeat(
        rng.standard_normal((7, 4)), 10, axis=0
    )  # one attitude in each bin: its mean is a rotation
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    zero = np.zeros((70, 3))
    known.add(
        PlatformStates(
            t, 10.0 * rng.standard_normal((70, 3)), turn, zero, zero, np.zeros((70, 6, 6)), t
        )
    )
    q = rng.standard_normal((30, p))
    q[::5] = 0.0
    assert curvatures(q, patches, known).sum(axis=0) == close(curvature_twin(q, patches, known))
    assert not curvatures(0.0 * q, patches, known).any()


def test_what_is_correlated_in_time():
    rng, k = np.random.default_rng(12), 23
    d, t, C = (
        rng.standard_normal((k, 3)),
        np.sort(rng.uniform(0.0, 9.0, k)),
        rng.standard_normal((k, k)),
    )
    bins, (constant, markov, same, own) = np.floor(t).astype(np.int64), (0.2, 0.5, 0.1, 0.3)
    share = (
        constant
        + markov * np.exp(-np.abs(t[:, None] - t))
        + same * (bins[:, None] == bins)
        + (own - same) * np.eye(k)
    )
    found = C.copy()
    correlated_kernel(
        d, np.exp(-np.diff(t, append=t[-1])), bins, (constant, markov, same, own), found
    )
    assert np.triu(found) == close(np.triu(C + d @ d.T * share)) and np.array_equal(
        np.tril(found, -1), np.tril(C, -1)
    )


@pytest.mark.parametrize("k", [0, 1, 128, 300])
def test_the_upper_triangle_of_a_product(k):
    A, B = np.random.default_rng(13).standard_normal((2, k, 7))
    assert np.triu(upper_product(A, B)) == close(np.triu(A @ B.T))

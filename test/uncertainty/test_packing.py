"""What is held in few bits: the kernels against plain algebra, and what the fewer digits do to a
variance.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rough_sheet import rough, still
from volume_surfaces import by_position_and_attitude

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import FilterUpdate, Patches
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.uncertainty import packing
from ladar_volume.uncertainty.packing import (
    LARGEST,
    ONE,
    PIVOT,
    SCALE,
    SHARED,
    factor_loads,
    unpack_patches,
)
from ladar_volume.uncertainty.patch_table import PatchStore
from ladar_volume.uncertainty.propagation import (
    calibration_sensitivity,
    independent_covariance,
    navigation_sensitivity,
    patch_loads,
    surface_geometry,
)


@pytest.fixture(scope="module")
def surface():
    """A rough, stepped sheet as the filter sends it, and as it is held."""
    f = SurfaceFilter(
        Parameters.read({"filter": {"radius_m": 0.5, "cap_per_voxel": 8, "trials": 10}})
    )
    f.add_platform(still(np.arange(11) * 1_000_000_000))
    f.add(rough(4000, 3))
    update, store = f.finish(), PatchStore()
    store.replace(update)
    return update, store.patches


def by_patch(patches, row):
    """Keys of the other patches and blocks of one patch."""
    part = slice(patches.cross_start[row], patches.cross_start[row + 1])
    return patches.cross_key[part].tolist(), patches.cross[part]


def test_blocks_against_plain_algebra(surface):
    update, held = surface
    sent, p = update.patches, 6
    own = {int(key): by_patch(sent, i)[1][0].astype(np.float64) for i, key in enumerate(sent.key)}
    row, clear = {int(key): i for i, key in enumerate(held.key)}, 0
    for i, key in enumerate(held.key.tolist()):
        C = own[key]
        quadric = bool((np.diag(C) > 0.0).all())
        if quadric and (np.diag(np.linalg.cholesky(C)) ** 2 > 2.0 * PIVOT * np.diag(C)).all():
            assert held.factor[i] / SCALE == pytest.approx(
                np.linalg.cholesky(C), rel=1e-6, abs=1e-12
            )
            clear += 1
        F, others = (
            held.factor[i].astype(np.float64),
            dict(zip(*by_patch(sent, int(np.flatnonzero(sent.key == key)[0])), strict=True)),
        )
        live = np.diag(F) > 0.0
        for other, R in zip(*by_patch(held, i), strict=True):
            G = held.factor[row[other]].astype(np.float64)
            alive = np.diag(G) > 0.0
            twin = np.zeros((p, p))
            twin[np.ix_(live, alive)] = np.linalg.solve(
                F[np.ix_(live, live)],
                np.linalg.solve(
                    G[np.ix_(alive, alive)], others[other].astype(np.float64)[np.ix_(live, alive)].T
                ).T,
            )
            assert np.abs(R - twin).max() <= 0.5 + 1e-6 and np.abs(R.astype(int)).max() <= ONE
    assert clear > 100


def test_a_variance_errs_by_less_than_the_bound_and_hardly_at_all(surface):
    update, held = surface
    sent = update.patches
    rng = np.random.default_rng(2)
    plain, packed = surface_geometry(update.points, sent), surface_geometry(update.points, held)
    smooth = np.zeros((len(update.points), 1, 3))
    smooth[:, 0, 2] = 1.0
    white = [rng.standard_normal(smooth.shape) for _ in range(8)]
    errors = []
    for gradient in (smooth, *white):
        q = patch_loads(gradient, sent, plain)
        assert patch_loads(gradient, held, packed).tobytes() == q.tobytes()
        before, after = (
            float(independent_covariance(q, patches, g)[0, 0])
            for patches, g in ((sent, plain), (held, packed))
        )
        turned = factor_loads(q, held)
        assert turned == pytest.approx(
            np.einsum("mrs,mrk->msk", held.factor, q[:, :6]), rel=1e-12, abs=1e-15
        )
        row = rng.permutation(len(held))
        X = np.ascontiguousarray(q[row, : held.factor.shape[1], 0])
        assert packing.factor_rows(X.copy(), row, held) == pytest.approx(
            np.einsum("nr,nrs->ns", X, held.factor[row]), rel=1e-12, abs=1e-15
        )
        assert np.array_equal(factor_loads(q, sent), q[:, :6])
        y = np.abs(turned[:, :, 0]).sum(axis=1)  # of half a whole number
        weight = np.where(packed.block_rows == packed.right, 0.5, 1.0)
        assert abs(after - before) <= float(
            (weight * y[packed.block_rows] * y[packed.right]).sum()
        ) * (1 + 1e-6)
        errors.append(after / before - 1.0)
    # and the root to a twentieth of a percent: of a mean height, and of loads as independent as no
    # volume has them, of which there are few on so small a sheet, in the mean
    assert abs(errors[0]) < 1e-3 and abs(np.mean(errors[1:])) < 1e-3
    assert np.abs(errors).max() < 5e-3


def test_sensitivities_keep_fifteen_bits_of_the_largest(surface):
    update, held = surface
    sent, rows = update.patches, np.arange(len(held))
    assert np.array_equal(sent.key, held.key)
    back = unpack_patches(held, 0, len(held))
    assert back.M_cal[..., :SHARED].tobytes() == sent.M_cal[..., :SHARED].tobytes()
    mine = sent.M_cal[..., SHARED:].reshape(*sent.M_cal.shape[:2], 2, -1)
    error = np.abs(back.M_cal[..., SHARED:].reshape(mine.shape) - mine).max(axis=3)
    assert (error <= np.abs(mine).max(axis=3) / (2 * LARGEST) * 1.01).all() and error.max() > 0.0
    loads = np.random.default_rng(2).standard_normal((len(held), 8))
    assert calibration_sensitivity(loads, held) == pytest.approx(
        np.einsum("mr,mrc->c", loads, back.M_cal.astype(np.float64)),
        rel=1e-6,
        abs=1e-6 * float(np.abs(back.M_cal).max()),
    )
    beams = np.ascontiguousarray(sent.M_cal[:5, :, SHARED:])
    whole, unit = packing.beam_kernel(beams)
    halves = beams.reshape(*beams.shape[:2], 2, -1)
    assert np.array_equal(unit, np.abs(halves).max(axis=3) / np.float32(LARGEST))
    expected = np.divide(halves, unit[..., None], out=0.0 * halves, where=unit[..., None] > 0)
    assert np.array_equal(whole.reshape(halves.shape), np.rint(expected))
    owner = np.repeat(rows, np.diff(sent.nav_start))
    for kind in range(2):
        these = slice(kind, 1 + 3 * kind)
        mine = np.abs(sent.M_nav[..., these]).max(axis=2)
        most = np.zeros((len(rows), mine.shape[1]))
        np.maximum.at(most, owner, mine)
        error = np.abs(back.M_nav - sent.M_nav)[..., these].max(axis=2)
        assert (error <= most[owner] / (2 * LARGEST) * 1.01).all()
    q = np.abs(np.random.default_rng(3).standard_normal((len(held), 8)))
    (J, bins), (twin, same) = navigation_sensitivity(q, held), navigation_sensitivity(q, sent)
    total = np.einsum("lr,lrc->c", q[owner], np.abs(by_position_and_attitude(sent))).reshape(
        2, 3
    ).max(axis=1).repeat(3) / len(bins)
    assert np.array_equal(bins, same) and (np.abs(J - twin) <= 1e-5 * total).all()


def test_what_is_sent_again_is_held_the_same(surface):
    update, held = surface
    store, m = PatchStore(), len(held)
    for first in range(0, m, 100):
        last = min(first + 100, m)
        part = unpack_patches(held, first, last)
        store.replace(FilterUpdate(update.t_ns, part.key[:0], update.points, part, last == m))
    again = store.patches
    assert (np.abs(again.cross.astype(int) - held.cross) <= 1).all() and np.mean(
        again.cross == held.cross
    ) > 0.999
    assert again.factor == pytest.approx(held.factor, rel=1e-4, abs=1e-6 * float(held.factor.max()))
    assert (np.abs(again.M_nav.astype(int) - held.M_nav) <= 1).all()


def test_a_patch_without_a_block_and_one_nobody_knows():
    cross = np.diag([4.0, 0.0, 1.0]).astype(np.float32)[None].repeat(2, axis=0)
    blocks = np.concatenate([9 * cross[:1], cross])  # of 5 with 9, its own, and of 6 with 5
    factor = packing.factor_kernel(
        np.array([5, 6]), np.array([0, 2, 3]), np.array([9, 5, 5]), blocks
    )
    assert (
        np.array_equal(factor[0], (np.diag([2.0, 0.0, 1.0]) * SCALE).astype(np.float32))
        and not factor[1].any()
    )
    found = packing.block_kernel(
        np.array([7]), np.array([0, 2]), np.array([7, 9]), cross, np.array([7]), factor[:1]
    )
    assert np.array_equal(found[0], np.diag([127, 0, 127])) and not found[1].any()


def test_plain_patches_are_cut_as_they_are(surface):
    sent = surface[0].patches
    part = unpack_patches(sent, 5, 9)
    assert isinstance(part, Patches) and np.array_equal(part.key, sent.key[5:9])
    assert np.array_equal(part.cross, sent.cross[sent.cross_start[5] : sent.cross_start[9]])
    assert dataclasses.asdict(part)["nav_start"][0] == 0

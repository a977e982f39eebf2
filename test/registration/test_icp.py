"""Refinement of epochs: Monte Carlo of its covariance, agreement with Open3D, surfaces that slide,
hostile input.
"""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import RegistrationError
from ladar_volume.registration.icp import refine
from ladar_volume.registration.transform import Transform


def corner(n, rng, size=10.0):
    """Points and normals on three faces of a cube's corner."""
    p, nrm = rng.uniform(0, size, (n, 3)), np.zeros((n, 3))
    face = np.arange(n) % 3
    p[np.arange(n), face] = 0.0
    nrm[np.arange(n), face] = 1.0
    return p, nrm


def start(turn=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    return Transform(exp_so3(np.array(turn)), np.array(shift), np.zeros(3), 1.0, np.zeros((7, 7)))


def inner(p, margin=1.0):
    """Points well inside one face, whose partners lie on the same one."""
    return p[np.sum(p > margin, axis=1) == 2]


def test_exact_surfaces_come_back_exactly():
    rng = np.random.default_rng(1)
    (y, n), x = corner(20_000, rng), inner(corner(3000, rng)[0])
    T = start([0.004, -0.006, 0.01], [0.05, -0.04, 0.03])
    r = refine(T.apply_inverse(x), y, n, reach_m=0.6)
    assert r.transform.apply(T.apply_inverse(x)) == pytest.approx(x, abs=1e-9) and r.overlap > 0.99
    assert pytest.approx(T.R, abs=1e-10) == r.transform.R


@pytest.mark.parametrize("levelled", [False, True])
@pytest.mark.parametrize("cell_m", [0.0, 0.5])
def test_covariance_by_monte_carlo(levelled, cell_m):
    rng = np.random.default_rng(2)
    y, n = corner(20_000, rng)
    x = inner(corner(800, rng)[0])
    T = start([0, 0, 0.004] if levelled else [0.002, -0.003, 0.004], [0.02, 0.01, -0.02])
    errors, C = [], []
    for _ in range(60):
        r = refine(
            T.apply_inverse(x + 0.01 * rng.standard_normal(x.shape)),
            y,
            n,
            reach_m=0.6,
            levelled=levelled,
            cell_m=cell_m,
        ).transform
        D = T.R.T @ r.R
        errors.append([D[2, 1], D[0, 2], D[1, 0], *(r.t - T.apply(r.pivot[None])[0])])
        C.append(np.diag(r.C)[:6])
    free = [2, 3, 4, 5] if levelled else list(range(6))
    ratio = np.std(errors, axis=0)[free] / np.sqrt(np.mean(C, axis=0))[free]
    assert ratio == pytest.approx(1.0, abs=0.25) and np.sqrt(np.mean(ratio**2)) == pytest.approx(
        1.0, abs=0.12
    )
    assert np.delete(np.mean(C, axis=0), free).sum() == 0


def test_clusters_see_the_correlation_that_the_plain_formula_misses():
    """Residuals that are common within 1 m: the plain sigma is several times too small, that of
    cells is not.
    """
    rng = np.random.default_rng(3)
    y, n = corner(20_000, rng)
    x = inner(corner(3000, rng)[0])
    face = np.argmin(x, axis=1)
    errors, plain, cells = [], [], []
    for _ in range(40):
        bump = 0.01 * rng.standard_normal((3, 10, 10, 10))
        k = np.minimum(x.astype(int), 9)
        noisy = x.copy()
        noisy[np.arange(len(x)), face] += bump[face, k[:, 0], k[:, 1], k[:, 2]]
        a, b = (refine(noisy, y, n, reach_m=0.6, cell_m=c).transform for c in (0.0, 1.0))
        errors.append(a.t - a.pivot)
        plain.append(np.diag(a.C)[3:6])
        cells.append(np.diag(b.C)[3:6])
    spread = np.sqrt(np.mean(np.square(errors)))
    assert spread > 2.0 * np.sqrt(np.mean(plain)) and np.sqrt(
        np.mean(cells)
    ) / spread == pytest.approx(1.0, abs=0.25)


def test_what_changed_between_the_epochs_is_left_out():
    rng = np.random.default_rng(4)
    (y, n), x = corner(20_000, rng), inner(corner(3000, rng)[0])
    dug = (x[:, 2] == 0) & (x[:, 0] > 6)
    x[dug, 2] -= 0.3
    r = refine(x + 0.003 * rng.standard_normal(x.shape), y, n, reach_m=0.6)
    assert (
        np.abs(r.transform.t - r.transform.pivot).max() < 0.001
        and not np.isin(np.flatnonzero(dug), r.pairs[:, 0]).any()
    )


def test_open3d_finds_the_same():
    pytest.importorskip("open3d")
    from ladar_volume.io.epoch_registration import register_epochs

    rng = np.random.default_rng(5)
    (y, n), x = corner(20_000, rng), inner(corner(3000, rng)[0])
    x = x + 0.003 * rng.standard_normal(x.shape)
    shift = np.array([5e5, 5.5e6, 200.0])  # map coordinates cost nothing
    T = start([0.01, -0.01, 0.02], [0.1, -0.1, 0.1])
    own = refine(T.apply_inverse(x), y, n, reach_m=0.6).transform
    other = register_epochs(
        T.apply_inverse(x) + shift, y + shift, n, start(), reach_m=0.6
    ).transform
    assert other.apply(T.apply_inverse(x) + shift) - shift == pytest.approx(
        own.apply(T.apply_inverse(x)), abs=1e-5
    )
    assert other.C == pytest.approx(own.C, rel=0.02, abs=1e-12)


def reason(*args, **kwargs):
    with pytest.raises(RegistrationError) as caught:
        refine(*args, **{"reach_m": 0.5, **kwargs})
    return caught.value.reason


def test_refusals():
    rng = np.random.default_rng(6)
    y, n = corner(3000, rng)
    flat = y[n[:, 2] == 1]
    up = np.repeat([[0.0, 0, 1]], len(flat), axis=0)
    assert reason(flat, flat, up) == "icp_slides"
    assert reason(flat, flat, up, levelled=True) == "icp_slides"
    assert reason(y + 50, y, n) == "icp_no_overlap"
    assert reason(y[:5], y, n) == "icp_too_few"
    assert reason(y, y, n[:5]) == "icp_shape"
    assert reason(y * np.nan, y, n) == "icp_not_finite" and reason(y, y, 2 * n) == "icp_not_finite"
    assert reason(y, y, n, reach_m=0.0) == "icp_reach"
    assert reason(y, y, n, cell_m=50.0) == "icp_cells"

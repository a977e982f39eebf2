"""Transforms from sphere centres: exact recovery, Monte Carlo of the covariance, outlying spheres,
degenerate sets.
"""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import RegistrationError
from ladar_volume.registration.sphere_adjustment import register
from ladar_volume.registration.transform import Transform

KINDS = [(False, 1.0), (False, None), (True, 1.0), (True, None)]
#: Six spheres round a pit, m.
SPHERES = np.array([[10, 0, 1], [4, 9, 3.0], [-6, 8, 0.5], [-11, -1, 2], [-5, -9, 4], [6, -8, 1.5]])


def truth(levelled, scale, shift=(3000.0, -2000.0, 150.0)):
    rotation = exp_so3(np.array([0.0, 0.0, 2.2] if levelled else [0.3, -0.5, 2.2]))
    return Transform(
        rotation, np.array(shift), np.zeros(3), 1.0007 if scale is None else scale, np.zeros((7, 7))
    )


def random_covariances(n, rng, sigma=0.004):
    a = rng.standard_normal((n, 3, 3)) * sigma
    return a @ np.swapaxes(a, 1, 2) + (0.5 * sigma) ** 2 * np.eye(3)


def draw(C, rng):
    return np.einsum("nij,nj->ni", np.linalg.cholesky(C), rng.standard_normal((len(C), 3)))


def errors_of(found, true):
    """Parameter errors (7,) of a transform about its own pivot."""
    D = true.R.T @ found.R
    turn = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    return np.concatenate(
        [turn, found.t - true.apply(found.pivot[None])[0], [found.scale - true.scale]]
    )


@pytest.mark.parametrize(("levelled", "scale"), KINDS)
@pytest.mark.parametrize("weighted", [False, True])
def test_exact_centres_give_the_exact_transform(levelled, scale, weighted):
    T = truth(levelled, scale)
    C = random_covariances(6, np.random.default_rng(1)) if weighted else None
    r = register(SPHERES, T.apply(SPHERES), C, C, levelled=levelled, scale=scale)
    assert r.transform.apply(SPHERES) == pytest.approx(T.apply(SPHERES), abs=1e-9)
    assert pytest.approx(T.R, abs=1e-11) == r.transform.R and r.transform.scale == pytest.approx(
        T.scale, abs=1e-12
    )
    assert r.used.all() and r.consistent and np.abs(r.residuals).max() < 1e-9
    assert r.transform.apply_inverse(T.apply(SPHERES)) == pytest.approx(SPHERES, abs=1e-9)
    assert (r.transform.matrix() @ np.append(SPHERES[2], 1))[:3] == pytest.approx(
        T.apply(SPHERES)[2], abs=1e-9
    )


@pytest.mark.parametrize(("levelled", "scale"), [(True, 1.0), (True, None)])
def test_two_centres_suffice_where_levelled_three_else(levelled, scale):
    T = truth(levelled, scale)
    r = register(SPHERES[:2], T.apply(SPHERES[:2]), levelled=levelled, scale=scale)
    assert r.transform.apply(SPHERES) == pytest.approx(T.apply(SPHERES), abs=1e-9)
    full = truth(False, scale)
    assert register(SPHERES[:3], full.apply(SPHERES[:3]), scale=scale).transform.apply(
        SPHERES
    ) == pytest.approx(full.apply(SPHERES), abs=1e-9)


@pytest.mark.parametrize(("levelled", "scale"), KINDS)
def test_covariance_of_parameters_and_points_by_monte_carlo(levelled, scale):
    rng = np.random.default_rng(2)
    T, Cx, Cy = truth(levelled, scale), random_covariances(6, rng), random_covariances(6, rng)
    far = np.array([[30.0, 5, 2], [0, 0, -3]])
    errors, moved, chi2, C, C_far, redundancy = [], [], [], [], [], 0
    for _ in range(400):
        r = register(
            SPHERES + draw(Cx, rng),
            T.apply(SPHERES) + draw(Cy, rng),
            Cx,
            Cy,
            levelled=levelled,
            scale=scale,
            risk=1e-9,
        )
        errors.append(errors_of(r.transform, T))
        moved.append(r.transform.apply(far) - T.apply(far))
        chi2.append(r.sigma0**2)
        C, C_far, redundancy = (
            [*C, r.transform.C],
            [*C_far, r.transform.covariances(far)],
            r.redundancy,
        )
    C, sample = np.mean(C, axis=0), np.cov(np.array(errors).T)
    free = np.flatnonzero(np.diag(C) > 0)
    assert len(free) == (4 if levelled else 6) + (scale is None) and redundancy == 18 - len(free)
    assert np.sqrt(np.diag(sample)[free] / np.diag(C)[free]) == pytest.approx(1.0, abs=0.1)
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.06)
    # all of it at once, correlations included
    whole = np.linalg.solve(C[np.ix_(free, free)], sample[np.ix_(free, free)])
    assert np.linalg.eigvals(whole).real == pytest.approx(1.0, abs=0.35) and np.trace(whole) / len(
        free
    ) == pytest.approx(1.0, abs=0.06)
    for k in range(2):
        ratio = np.cov(np.array(moved)[:, k].T).diagonal() / np.mean(C_far, axis=0)[k].diagonal()
        assert np.sqrt(ratio) == pytest.approx(1.0, abs=0.1)


def test_correlated_centres_of_one_station_are_weighted_as_such():
    """A common shift of all target centres goes into the translation and into no residual."""
    rng = np.random.default_rng(3)
    own = np.kron(np.eye(6), 0.001**2 * np.eye(3))
    common = 0.02**2 * np.kron(np.ones((6, 6)), np.eye(3))
    T = truth(False, 1.0)
    a = register(
        SPHERES,
        T.apply(SPHERES) + 0.001 * rng.standard_normal((6, 3)) + [0.02, -0.01, 0.03],
        C_target=own + common,
    )
    assert a.consistent and np.abs(a.residuals).max() < 0.004
    assert np.sqrt(np.diag(a.transform.C)[3:6]) == pytest.approx(0.02, rel=0.02)
    with pytest.raises(RegistrationError):
        register(SPHERES, SPHERES, C_target=own[:5, :5])
    with pytest.raises(RegistrationError):
        register(SPHERES, SPHERES, C_target=-own)


def test_unknown_noise_scales_the_covariance():
    rng, T = np.random.default_rng(4), truth(False, 1.0)
    found = [
        register(SPHERES, T.apply(SPHERES) + 0.005 * rng.standard_normal((6, 3)), risk=1e-9)
        for _ in range(200)
    ]
    error = np.array([errors_of(f.transform, T) for f in found])[:, :6]
    predicted = np.mean([np.diag(f.transform.C)[:6] for f in found], axis=0)
    assert np.sqrt(error.var(axis=0) / predicted) == pytest.approx(1.0, abs=0.15)
    assert np.sqrt(np.mean([f.sigma0**2 for f in found])) == pytest.approx(
        0.005, rel=0.05
    ) and np.isnan(found[0].p_global)


@pytest.mark.parametrize(("levelled", "scale"), KINDS)
@pytest.mark.parametrize("bad", range(6))
def test_an_outlying_sphere_is_found_and_left_out(levelled, scale, bad):
    rng, T, C = (
        np.random.default_rng(5 + bad),
        truth(levelled, scale),
        np.repeat(0.003**2 * np.eye(3)[None], 6, axis=0),
    )
    y = T.apply(SPHERES) + draw(C, rng)
    y[bad] += [0.05, -0.04, 0.03]
    r = register(SPHERES, y, None, C, levelled=levelled, scale=scale)
    assert np.flatnonzero(~r.used).tolist() == [bad] and r.consistent
    assert (
        np.linalg.norm(r.residuals[bad]) > 0.04
        and r.p_value[bad] < 1e-6
        and np.nanmin(r.p_value[r.used]) > 1e-4
    )


def test_two_outlying_spheres_of_six():
    rng, T, C = (
        np.random.default_rng(6),
        truth(True, 1.0),
        np.repeat(0.003**2 * np.eye(3)[None], 6, axis=0),
    )
    y = T.apply(SPHERES) + draw(C, rng)
    y[1] += [0.2, 0, 0]
    y[4] += [0, 0, -0.1]
    r = register(SPHERES, y, None, C, levelled=True)
    assert np.flatnonzero(~r.used).tolist() == [1, 4] and r.consistent


def test_the_snooping_statistic_is_that_of_leaving_the_sphere_out():
    rng, T = np.random.default_rng(7), truth(False, 1.0)
    C = random_covariances(6, rng)
    y = T.apply(SPHERES) + draw(C, rng)
    whole = register(SPHERES, y, None, C, risk=1e-12)
    for i in range(6):
        keep = np.arange(6) != i
        rest = register(SPHERES[keep], y[keep], None, C[keep], risk=1e-12).transform
        v = y[i] - rest.apply(SPHERES[i : i + 1])[0]
        S = rest.covariances(SPHERES[i : i + 1])[0] + C[i]
        assert whole.statistic[i] == pytest.approx(v @ np.linalg.solve(S, v), rel=1e-3)


def test_good_spheres_are_rarely_called_outliers():
    rng, T = np.random.default_rng(8), truth(True, 1.0)
    C, lost = random_covariances(6, rng), 0
    for _ in range(400):
        lost += not register(
            SPHERES, T.apply(SPHERES) + draw(C, rng), None, C, levelled=True, risk=0.05
        ).used.all()
    assert 5 <= lost <= 38  # expected 20 at most


def test_jacobian_and_shared_variance():
    T = truth(False, None)
    T = Transform(
        T.R,
        T.t,
        np.array([1.0, 2, 3]),
        T.scale,
        np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4, 1e-8]),
    )
    J = T.jacobian(SPHERES)
    for k in range(7):
        step = np.eye(7)[k] * 1e-6
        assert (
            T.perturb(step).apply(SPHERES) - T.perturb(-step).apply(SPHERES)
        ) / 2e-6 == pytest.approx(J[:, :, k], abs=1e-6)
    g = np.random.default_rng(9).standard_normal((6, 3))
    assert T.variance(g, SPHERES) == pytest.approx(
        float(np.einsum("ni,nik,mjl,mj,kl->", g, J, J, g, T.C)), rel=1e-12
    )
    own = np.repeat(np.eye(3)[None], 6, axis=0)
    assert T.covariances(SPHERES, own) - T.covariances(SPHERES) == pytest.approx(
        T.scale**2 * own, abs=1e-12
    )


def test_turning_the_target_frame_turns_the_result():
    rng, Q = np.random.default_rng(10), exp_so3(np.array([0.1, 0.2, 0.3]))
    C = random_covariances(6, rng)
    y = SPHERES + draw(C, rng)
    a, b = register(SPHERES, y, None, C), register(SPHERES, y @ Q.T + [1, 2, 3], None, Q @ C @ Q.T)
    assert pytest.approx(Q @ a.transform.R, abs=1e-10) == b.transform.R
    assert b.transform.C[:3, :3] == pytest.approx(a.transform.C[:3, :3], rel=1e-6)
    order = rng.permutation(6)
    c = register(SPHERES[order], y[order], None, C[order])
    assert pytest.approx(
        a.transform.R, abs=1e-11
    ) == c.transform.R and c.statistic == pytest.approx(a.statistic[order], rel=1e-6)


def reason(*args, **kwargs):
    with pytest.raises(RegistrationError) as caught:
        register(*args, **kwargs)
    return caught.value.reason


def test_refusals():
    line = np.outer(np.arange(5.0), [1, 2, 0.5])
    mast = np.array([[3.0, 4, 0], [3, 4, 2], [3, 4, 5]])
    same = np.ones((4, 3))
    assert reason(SPHERES[:2], SPHERES[:2]) == "registration_too_few"
    assert reason(SPHERES[:1], SPHERES[:1], levelled=True) == "registration_too_few"
    assert reason(line, line) == "registration_collinear"
    assert reason(SPHERES[:5], line) == "registration_collinear"
    assert reason(line + 5e5, line + 5e5) == "registration_collinear"
    assert reason(same, same) == "registration_collinear"
    assert reason(mast, mast, levelled=True) == "registration_vertical"
    assert reason(same, same, levelled=True) == "registration_vertical"
    assert register(line, line, levelled=True).consistent
    assert reason(SPHERES, SPHERES[:5]) == "registration_shape"
    assert reason(SPHERES * np.nan, SPHERES) == "registration_not_finite"
    assert reason(SPHERES, SPHERES, scale=0.0) == "registration_scale"
    near = line + np.random.default_rng(11).standard_normal((5, 3)) * 0.01
    assert (
        reason(near, near, C_target=np.repeat(0.01**2 * np.eye(3)[None], 5, axis=0))
        == "registration_weak"
    )


def test_a_mirrored_frame_is_not_called_consistent():
    C = np.repeat(0.005**2 * np.eye(3)[None], 6, axis=0)
    r = register(SPHERES, SPHERES * [1, 1, -1], None, C)
    assert np.linalg.det(r.transform.R) == pytest.approx(1.0) and not r.consistent


def test_three_spheres_tell_that_one_is_wrong_but_not_which():
    C = np.repeat(0.003**2 * np.eye(3)[None], 3, axis=0)
    y = SPHERES[:3].copy()
    y[1, :2] *= 1.01
    r = register(SPHERES[:3], y, None, C)
    assert r.used.all() and not r.consistent and r.p_global < 1e-6

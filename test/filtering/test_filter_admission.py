"""Admission of points against the plain twins."""

import numpy as np

from ladar_volume.filtering import admission, reference
from ladar_volume.georeference.sensitivity import bracket
from ladar_volume.model.records import select


def test_admission_and_geometry_are_those_of_the_twins(scene):
    rng = np.random.default_rng(0)
    states = scene.platform()
    states.q_map_body[::3] *= -1  # the same attitude
    states.segment[400:] = 1
    states.segment[700:710] = -1
    states.segment[710:] = 2
    states = select(states, rng.random(len(states)) < 0.8)
    n = 4000
    t = rng.integers(-100_000_000, 10_100_000_000, n)
    t[:1000] = np.sort(t[:1000])
    t[1000:1200] = rng.choice(states.t_ns, 200)
    t[1200:1202] = states.t_ns[[0, -1]]
    r, C = rng.normal(size=(n, 3)) * 10, np.ones((n, 6), np.float32)
    verdict, state, fraction = np.zeros(n, np.int8), np.zeros(n, np.int64), np.zeros(n)
    admission.admit(t, r, C, 1e6, states.t_ns, states.segment, verdict, state, fraction)
    covered, k, f = bracket(t, states.t_ns, states.segment)
    taken = verdict == admission.TAKEN
    assert np.array_equal(taken, covered) and 1000 < taken.sum() < n
    assert np.array_equal(state[taken], k[taken]) and np.array_equal(fraction[taken], f[taken])

    rows = np.flatnonzero(taken)
    slots = rng.permutation(len(rows))
    aux = np.zeros((len(rows), 13))
    laser, antenna = np.array([0.1, -0.2, 0.3]), np.array([-0.3, 0.1, 0.8])
    admission.geometry(
        rows, slots, r, state, fraction, states.p_map_body, states.q_map_body, states.v_body, states.omega_body, laser, antenna, aux
    )
    expected = reference.geometry(r[rows], states, k[rows], f[rows], laser, antenna)
    same = np.where((aux[slots, :4] * expected[:, :4]).sum(axis=1) < 0, -1.0, 1.0)
    assert np.abs(aux[slots, :4] * same[:, None] - expected[:, :4]).max() < 1e-9
    assert np.abs(aux[slots, 4:] - expected[:, 4:]).max() < 1e-7


def test_verdicts_name_the_reason(scene):
    states = scene.platform()
    r, C, t = np.zeros((6, 3)), np.zeros((6, 6), np.float32), np.full(6, 5_000_000_000)
    r[0, 0], r[1, 1], C[2, 5], r[3, 2], t[4] = np.nan, -np.inf, np.nan, -2e6, -1
    r[1, 2] = np.inf  # opposite infinities do not cancel
    verdict, state, fraction = np.zeros(6, np.int8), np.zeros(6, np.int64), np.zeros(6)
    admission.admit(t, r, C, 1e6, states.t_ns, states.segment, verdict, state, fraction)
    assert verdict.tolist() == [admission.NOT_FINITE] * 3 + [admission.TOO_FAR, admission.UNCOVERED, admission.TAKEN]

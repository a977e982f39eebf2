"""Wrong numbers of spheres: found by the distances, or refused with what the matter is."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import RegistrationError
from ladar_volume.registration.correspondence import Centres, correspond
from ladar_volume.registration.sphere_matching import numberings
from ladar_volume.registration.sphere_verdict import cycles

SIGMA = 0.001


def scattered(n, rng):
    """Centres (n, 3) at least 2 m apart, not near one line."""
    while True:
        r = np.column_stack([rng.uniform(-15, 15, (n, 2)), rng.uniform(0, 4, n)])
        far = np.linalg.norm(r[:, None] - r[None], axis=2)[np.triu_indices(n, 1)]
        if far.min() > 2.0 and np.linalg.svd(r - r.mean(axis=0), compute_uv=False)[1] > 6.0:
            return r


def frames(n, seed, levelled=False):
    """Both sets of centres with noise, and the true rotation and shift."""
    rng = np.random.default_rng(seed)
    x, turn = scattered(n, rng), rng.uniform(-np.pi, np.pi)
    tilt = np.zeros(2) if levelled else rng.normal(0.0, 0.1, 2)
    R, t = exp_so3(np.array([*tilt, turn])), rng.uniform(-100.0, 100.0, 3)
    y = x @ R.T + t
    return x + rng.normal(0, SIGMA, x.shape), y + rng.normal(0, SIGMA, x.shape), R, t


def centres(r, number=None):
    number = np.arange(len(r)) if number is None else np.asarray(number)
    return Centres(number.astype(np.int64), r, np.repeat(SIGMA**2 * np.eye(3)[None], len(r), 0))


def error_m(found, x, R, t):
    return float(np.abs(found.registration.transform.apply(x) - (x @ R.T + t)).max())


@pytest.mark.parametrize("n", [3, 4, 5])
def test_every_permutation_is_found(n):
    x, y, R, t = frames(n, n)
    for order in itertools.permutations(range(n)):
        found = correspond(centres(x), centres(y, order))
        assert error_m(found, x, R, t) < 10.0 * SIGMA
        assert found.renumbered == (order != tuple(range(n))) and found.others == 0


@pytest.mark.parametrize("levelled", [False, True])
def test_random_permutations_of_six_and_one_that_moved(levelled):
    for seed in range(15):
        rng = np.random.default_rng(100 + seed)
        x, y, R, t = frames(6, seed, levelled)
        y[rng.integers(6)] += rng.normal(0.0, 0.3, 3)
        order = rng.permutation(6)
        found = correspond(centres(x), centres(y, order), levelled=levelled)
        assert error_m(found, x, R, t) < 10.0 * SIGMA and found.renumbered
        assert found.registration.used.sum() == 5 and found.registration.consistent


def refused(*args, **kwargs):
    with pytest.raises(RegistrationError) as caught:
        correspond(*args, **kwargs)
    return caught.value


def test_units_mirrors_and_moved_spheres_are_named():
    x, y, _, _ = frames(5, 1)
    error = refused(centres(x), centres(1000.0 * y))
    assert error.reason == "registration_units" and "millimetres" in str(error)
    error = refused(centres(x), centres(y / 0.3048))
    assert "feet" in str(error) and error.value == pytest.approx(1 / 0.3048, rel=1e-3)
    error = refused(centres(x), centres(y * [1.0, -1.0, 1.0]))
    assert error.reason == "registration_mirrored"
    moved = y[:3] + np.array([[0.5, 0.2, 0], [0, 0, 0], [0, 0, 0]])
    error = refused(centres(x[:3]), centres(moved))
    assert error.reason == "registration_disagree" and "did one move" in str(error)


def test_a_symmetric_layout_is_said():
    square = np.array([[5.0, 5, 1], [-5, 5, 1], [-5, -5, 1], [5, -5, 1]])
    found = correspond(centres(square), centres(square))
    assert not found.renumbered and found.others >= 3  # turned by 90, 180 and 270 degrees at least
    error = refused(centres(square), centres(square, [0, 2, 1, 3]))
    assert error.reason == "registration_numbers"


def test_numbers_that_have_nothing_in_common():
    x, y, R, t = frames(5, 7)
    found = correspond(centres(x), centres(y, np.arange(5) + 20))
    assert found.renumbered and error_m(found, x, R, t) < 10.0 * SIGMA
    assert refused(centres(x[:2]), centres(y[:2], [7, 8])).reason == "registration_too_few"


def test_scale_is_found_with_the_numbering():
    x, y, _, _ = frames(5, 3)
    best = numberings(x, 2.5 * y[[2, 0, 1, 4, 3]], 0.002, scale=None)[0]
    assert len(best) == 5 and best.scale == pytest.approx(2.5, rel=1e-3)
    assert best.partner.tolist() == [1, 2, 0, 4, 3]
    assert numberings(x[:2], y, 0.001) == []


def test_words_of_a_permutation():
    assert cycles(np.array([1, 2, 3]), np.array([1, 3, 2])) == "spheres 2 and 3 were swapped"
    three = cycles(np.array([1, 2, 3]), np.array([2, 3, 1]))
    assert three.startswith("sphere 1 of A is number 2 in B, sphere 2") and three.count("B") == 3

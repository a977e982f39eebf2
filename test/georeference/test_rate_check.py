"""Rates against the attitudes they come with: each way of being wrong is named, the right one and
platforms that stand are not.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.georeference.rate_check import FEWEST, RateCheck, window_kind

STEP_S = 0.02


def motion(seconds=20.0, seed=1):
    """Times (n,) ns, attitudes (n, 4) and body rates (n, 3) of a platform that sways and turns."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP_S)
    phase, size = rng.uniform(0.0, 6.0, 3), np.array([0.2, 0.3, 0.7])
    rates = size * np.cos(np.outer(t, [0.7, 0.9, 0.4]) + phase)
    q, out = Rotation.from_euler("z", 130, degrees=True), []
    for k in range(len(t)):
        out.append(q.as_quat())
        middle = rates[k : k + 2].mean(axis=0)
        q = q * Rotation.from_rotvec(STEP_S * middle)
    return (1e9 * t).astype(np.int64) + 1_700_000_000_000_000_000, np.array(out), rates


def checked(t, q, rates):
    found = RateCheck()
    for each in zip(t, q, rates, strict=True):
        found.add(int(each[0]), each[1], each[2])
    return found


WRONG = {
    "degrees": (lambda q, w: (q, np.rad2deg(w)), "degrees per second"),
    "unset": (lambda q, w: (q, 0.0 * w), "stay at 0"),
    "axes": (lambda q, w: (q, w[:, [1, 2, 0]]), "other axes"),
    "sign": (lambda q, w: (q, -w), "other axes"),
    "still": (lambda q, w: (np.repeat(q[:1], len(q), axis=0), w), "stand still"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_rates_is_named(name):
    spoil, words = WRONG[name]
    t, q, rates = motion()
    (doubt,) = checked(t, *spoil(q, rates)).doubts().doubts
    assert doubt.name == "angular_velocity" and words in doubt.text
    assert doubt.value >= FEWEST


@pytest.mark.parametrize("noise_deg", [0.0, 0.1, 0.3])
def test_right_rates_are_not_doubted(noise_deg):
    t, q, rates = motion()
    rng = np.random.default_rng(5)
    shaken = Rotation.from_quat(q) * Rotation.from_rotvec(
        np.deg2rad(noise_deg) * rng.normal(size=(len(q), 3))
    )
    found = checked(t, shaken.as_quat(), rates + rng.normal(0.0, 0.02, rates.shape))
    assert found.doubts().sound
    assert found.windows["right"] >= FEWEST


def test_the_sign_of_a_quaternion_means_nothing():
    t, q, rates = motion()
    flip = np.where(np.arange(len(q)) % 3 == 0, -1.0, 1.0)[:, None]
    assert checked(t, flip * q, rates).windows == checked(t, q, rates).windows


def test_a_platform_that_stands_tells_nothing():
    t, q, rates = motion()
    rng = np.random.default_rng(7)
    still = Rotation.from_rotvec(np.deg2rad(0.2) * rng.normal(size=(len(q), 3))).as_quat()
    for standing in (0.0 * rates, rng.normal(0.0, 0.02, rates.shape)):
        found = checked(t, still, standing)
        assert found.doubts().sound and not sum(found.windows.values())


def test_attitudes_too_noisy_to_tell_are_no_rates_left_at_zero():
    t, q, rates = motion()
    rng = np.random.default_rng(8)
    noisy = Rotation.from_rotvec(np.deg2rad(4.0) * rng.normal(size=(len(q), 3))).as_quat()
    found = checked(t, noisy, rng.normal(0.0, 0.002, rates.shape))
    assert sum(found.windows.values()) > FEWEST and found.doubts().sound


def test_gaps_unknown_rates_and_a_clock_that_stands_make_no_window():
    t, q, rates = motion()
    assert not sum(checked(t * 20, q, rates).windows.values())
    assert not sum(checked(t, q, np.full_like(rates, np.nan)).windows.values())
    assert not sum(checked(np.full_like(t, 5), q, rates).windows.values())


def test_a_few_damaged_attitudes_do_not_decide():
    t, q, rates = motion(60.0)
    rates[:300] = 0.0
    assert checked(t, q, rates).doubts().sound


@pytest.mark.parametrize(
    ("turn", "told", "kind"),
    [
        ([0.1, 0.0, 0.0], [0.1, 0.0, 0.0], "right"),
        ([0.1, 0.0, 0.0], [0.21, 0.0, 0.0], "other"),
        ([0.1, 0.0, 0.0], [0.0, 0.1, 0.0], "axes"),
        ([0.1, 0.0, 0.0], [0.001, 0.0, 0.0], "other"),
        ([0.1, 0.0, 0.0], [0.0, 0.0, 0.0], "unset"),
        ([0.02, 0.0, 0.0], [1.146, 0.0, 0.0], "degrees"),
        ([0.0, 0.0, 0.0], [0.3, 0.0, 0.0], "still"),
        ([0.03, 0.0, 0.0], [0.3, 0.0, 0.0], "other"),
        ([0.03, 0.0, 0.0], [0.1, 0.0, 0.0], None),
    ],
)
def test_a_window_is_sorted(turn, told, kind):
    assert window_kind(np.array(turn), np.array(told)) == kind

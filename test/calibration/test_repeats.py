"""Sigmas from repeated measurements: closed forms, and whether the intervals hold what they
promise.
"""

import numpy as np
import pytest

from ladar_volume.calibration.repeats import (
    boresight_vectors,
    budget_sigma,
    components,
    correction_of,
    spread,
)
from ladar_volume.math.se3 import exp_so3, rotation_xyz
from ladar_volume.model.errors import CalibrationError


def test_three_values_by_hand():
    s = spread([1.0, 2.0, 3.0])
    assert (s.count, s.mean, s.sigma_single, s.freedom) == (3, 2.0, 1.0, 2)
    assert s.sigma_mean == pytest.approx(1 / np.sqrt(3))
    assert s.mean_interval == pytest.approx(
        (2 - 4.302653 / np.sqrt(3), 2 + 4.302653 / np.sqrt(3)), rel=1e-6
    )
    assert s.single_interval == pytest.approx(
        (1 / np.sqrt(7.377759 / 2), 1 / np.sqrt(0.0506356 / 2)), rel=1e-5
    )


def test_thirty_tape_measurements_give_a_much_better_mean():
    y = np.random.default_rng(1).normal(0.12, 0.000348, 30)
    s = spread(y)
    assert budget_sigma(s, "single") / budget_sigma(s, "mean") == pytest.approx(np.sqrt(30))
    assert budget_sigma(s, "remounted") == pytest.approx(s.sigma_single * np.sqrt(1 + 1 / 30))


def test_two_mountings_by_hand():
    c = components([1.0, 3.0, 7.0, 9.0], ["a", "a", "b", "b"])
    # within: (1 + 1 + 1 + 1) / 2; means 2 and 8 with variance 18, of which 2 / 2 is the
    # calibration's
    assert c.sigma_within == pytest.approx(np.sqrt(2)) and c.sigma_between == pytest.approx(
        np.sqrt(18 - 1)
    )
    assert (c.mean, c.sigma_mean) == (5.0, 3.0) and (c.last_mean, c.last_count) == (8.0, 2)
    assert budget_sigma(c, "single") == c.sigma_within
    assert budget_sigma(c, "mean") == pytest.approx(1.0)
    assert budget_sigma(c, "remounted") == pytest.approx(np.sqrt(17 + 9))


def test_order_and_labels_of_the_mountings_do_not_matter():
    rng = np.random.default_rng(2)
    label = np.repeat([0, 1, 2, 3], [5, 2, 3, 4])
    y = rng.normal(size=4)[label] + 0.2 * rng.normal(size=14)
    a, order = components(y, label), rng.permutation(13)  # the last row stays the last
    b = components(np.append(y[order], y[13]), [f"m{9 - k}" for k in (*label[order], label[13])])
    assert (
        np.array(list(vars(a).values()), object)[[0, 10]].tolist()
        == np.array(list(vars(b).values()), object)[[0, 10]].tolist()
    )
    assert (a.sigma_within, a.sigma_between, a.sigma_mean, a.last_mean) == pytest.approx(
        (b.sigma_within, b.sigma_between, b.sigma_mean, b.last_mean)
    )


@pytest.mark.parametrize("counts", [[3] * 8, [1, 1, 2, 3, 5, 8]])
def test_the_intervals_hold_the_truth(counts):
    rng, label, inside, runs = (
        np.random.default_rng(3),
        np.repeat(np.arange(len(counts)), counts),
        np.zeros(4),
        800,
    )
    for _ in range(runs):
        y = 5.0 + 0.8 * rng.normal(size=len(counts))[label] + 0.5 * rng.normal(size=len(label))
        c, s = components(y, label), spread(rng.normal(1.0, 2.0, 6))
        inside += [
            c.within_interval[0] <= 0.5 <= c.within_interval[1],
            c.between_interval[0] <= 0.8 <= c.between_interval[1],
            s.single_interval[0] <= 2.0 <= s.single_interval[1],
            s.mean_interval[0] <= 1.0 <= s.mean_interval[1],
        ]
    assert inside[[0, 2, 3]] / runs == pytest.approx(0.95, abs=0.025)
    assert (
        0.93 <= inside[1] / runs <= 0.985
    )  # Tukey and Williams' interval is on the safe side; unequal counts are an approximation


def test_no_variation_between_mountings_is_said():
    rng, label = np.random.default_rng(4), np.repeat(np.arange(10), 4)
    p = [components(rng.normal(size=40), label).p_value for _ in range(250)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(0.05, abs=0.04)
    same = components([1.0, 1.0, 2.0, 2.0], [0, 0, 1, 1])
    assert same.sigma_within == 0.0 and same.p_value == 0.0


@pytest.mark.parametrize("pitch", [0.0, 1.0, np.pi / 2])
def test_boresights_are_averaged_as_rotations(pitch):
    rng, nominal = np.random.default_rng(5), rotation_xyz(0.1, pitch, -0.3)
    small = rng.normal(0, 0.003, (200, 3))
    angles = []
    for R in exp_so3(small) @ nominal:
        p = -np.arcsin(np.clip(R[2, 0], -1, 1))
        angles.append([np.arctan2(R[2, 1], R[2, 2]), p, np.arctan2(R[1, 0], R[0, 0])])
    vectors, mean = boresight_vectors(np.array(angles))
    assert np.abs(vectors.mean(axis=0)).max() < 1e-6
    assert vectors.std(axis=0, ddof=1) == pytest.approx(small.std(axis=0, ddof=1), rel=1e-3)
    assert correction_of(mean, 0.1, pitch, -0.3) == pytest.approx(small.mean(axis=0), abs=2e-6)


@pytest.mark.parametrize(
    ("values", "label", "reason"),
    [
        ([1.0], None, "calibration_too_few"),
        ([1.0, np.nan], None, "calibration_values"),
        ([2.0, 2.0], None, "calibration_no_spread"),
        ([1.0, 2.0], [0, 0], "calibration_mountings"),
        ([1.0, 2.0], [0, 1], "calibration_no_repeats"),
        ([1.0, 2.0], [0], "calibration_values"),
        ([[1.0, 2.0]], None, "calibration_too_few"),
    ],
)
def test_bad_values_are_refused(values, label, reason):
    with pytest.raises(CalibrationError) as error:
        spread(values) if label is None else components(values, label)
    assert error.value.reason == reason


def test_confidence_and_use_are_checked():
    with pytest.raises(CalibrationError, match="confidence"):
        spread([1.0, 2.0], 1.0)
    with pytest.raises(CalibrationError, match="no use"):
        budget_sigma(spread([1.0, 2.0]), "best")

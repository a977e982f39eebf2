"""Correlations of the calibration in the budget: read, written, refused, and one line of the
volume's budget.
"""

import dataclasses

import numpy as np
import pytest

from ladar_volume.georeference.error_budget import calibration_covariance, correlation_triangle
from ladar_volume.io.config import changed_config, read_config
from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.parameters import BudgetParameters, Parameters
from ladar_volume.uncertainty.propagation import calibration_marginals, calibration_variance

BEAMS = 3


def correlated(size, seed=1):
    a = np.random.default_rng(seed).normal(size=(size, 2 * size))
    C = a @ a.T
    s = np.sqrt(np.diag(calibration_covariance(BudgetParameters(), BEAMS))[:size] / np.diag(C))
    return s[:, None] * C * s


@pytest.mark.parametrize("size", [11, 11 + 2 * BEAMS])
def test_a_covariance_survives_the_file(size, tmp_path):
    C = correlated(size)
    budget = dataclasses.replace(
        BudgetParameters(), calibration_correlation=correlation_triangle(C)
    )
    file = tmp_path / "c.yaml"
    file.write_text(changed_config(dataclasses.replace(Parameters(), budget=budget), {}, "test"))
    found = calibration_covariance(read_config(file).budget, BEAMS)
    assert found[:size, :size] == pytest.approx(C, rel=1e-6, abs=1e-9 * C.max())
    assert not found[:size, size:].any() and (np.linalg.eigvalsh(found) > 0).all()
    J = np.linspace(1.0, 2.0, 11 + 2 * BEAMS)
    boresight = calibration_marginals(J, found)["boresight"]
    assert boresight == pytest.approx(
        J[1:4] @ found[1:4, 1:4] @ J[1:4]
    ) and boresight != pytest.approx(J @ found @ J)
    assert calibration_variance(J, found) == {"calibration": pytest.approx(J @ found @ J)}


def test_without_correlations_it_is_diagonal():
    C = calibration_covariance(BudgetParameters(), BEAMS)
    assert np.array_equal(C, np.diag(np.diag(C)))
    assert not calibration_covariance(BudgetParameters(), BEAMS, "odometry")[7:10].any()


def test_odometry_has_no_antenna_whatever_the_correlations():
    budget = dataclasses.replace(
        BudgetParameters(), calibration_correlation=correlation_triangle(correlated(11))
    )
    C = calibration_covariance(budget, BEAMS, "odometry")
    assert not C[7:10].any() and not C[:, 7:10].any() and C[1, 4] != 0


def test_zero_variance_correlates_with_nothing():
    assert correlation_triangle(np.diag([1.0, 0.0, 2.0])) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("values", "words"),
    [((0.1,) * 54, "54 values; 55 or 136"), ((0.99, -0.99, *[0.99] * 53), "eigenvalue")],
)
def test_impossible_correlations_are_refused(values, words):
    with pytest.raises(ParameterValueError, match=words):
        calibration_covariance(
            dataclasses.replace(BudgetParameters(), calibration_correlation=values), BEAMS
        )

"""What drawn errors do: in the order of the columns, and by time bins."""

import numpy as np
import pytest

from benchmarks.drawn_effects import bin_means, drawn_calibration
from benchmarks.survey_bodies import DURATION_S, scene_of
from ladar_volume.georeference.error_budget import calibration_columns
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.survey_parameters import SurveyParameters
from ladar_volume.simulation.platforms import platform_for
from ladar_volume.simulation.survey import Survey


def test_drawn_errors_are_those_of_the_columns():
    scene = scene_of(1)[1]
    platform = platform_for(scene, "rover", DURATION_S)
    drawn = Survey(scene, platform, BudgetParameters(), SurveyParameters(DURATION_S, 4, seed=1))
    error = dict(zip(calibration_columns(16), drawn_calibration(drawn), strict=True))
    believed = np.array(platform.lever_antenna_m)
    found = [error[name] for name in calibration_columns(16)[7:10]]
    assert found == pytest.approx(believed - drawn.truth["lever_antenna_m"])
    assert error["beam_range_3"] == drawn.truth["beam_range_m"][3]
    assert error["beam_vertical_5"] == -drawn.truth["beam_vertical_rad"][5]


def test_means_over_bins_leave_out_what_is_in_none():
    t, error = np.array([0, 5, 10, 12, 25]), np.arange(15.0).reshape(5, 3)
    found = bin_means(t, error, np.array([0, 1]), 10)
    assert found == pytest.approx(np.array([error[:2].mean(axis=0), error[2:4].mean(axis=0)]))

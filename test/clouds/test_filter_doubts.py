"""A filter that takes out much of a survey says so, with the reason that took most."""

import numpy as np

from ladar_volume.clouds.filter.filter_doubts import doubts
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.model.parameters import FilterParameters


def report(**counts):
    return {"points": 1000, "kept": 1000, "noise_m": 0.01, **counts}


def test_a_few_outliers_are_no_doubt():
    assert doubts(report(kept=880, outlier=120), True).sound


def test_much_that_was_removed_is_named_with_its_main_reason():
    (doubt,) = doubts(report(kept=700, outlier=90, no_surface=210), True).doubts
    assert doubt.name == "filter_removed"
    assert np.isclose(doubt.value, 0.3)
    assert "30.0 % of the points" in doubt.text
    assert "21.0 % where no surface was found" in doubt.text


def test_sparse_points_are_kept_and_are_no_removal():
    (doubt,) = doubts(report(sparse=600), True).doubts
    assert doubt.name == "filter_sparse"


def test_a_tree_crown_over_ground_is_doubted():
    rng = np.random.default_rng(5)
    ground = np.c_[rng.uniform(0.0, 10.0, (3000, 2)), rng.normal(0.0, 0.01, 3000)]
    crown = rng.uniform((0.0, 0.0, 2.0), (10.0, 10.0, 12.0), (2000, 3))
    result = filter_cloud(np.r_[ground, crown], FilterParameters(), auto=True)
    assert "filter_removed" in [doubt.name for doubt in result.verdict.doubts]

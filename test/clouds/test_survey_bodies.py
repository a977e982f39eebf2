"""Closed bodies of a survey: gradients find the survey's own points, sides apart."""

import numpy as np
import pytest

from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.survey.survey_bodies import around, objects_on
from ladar_volume.clouds.survey.survey_gradient import on_survey
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import ConfigurationError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import FilteredPoints


def plates(thick, spacing=0.1):
    """Both sides of an upright plate, as a survey's points."""
    y, z = (a.ravel() for a in np.meshgrid(np.arange(0, 2, spacing), np.arange(0, 1, spacing)))
    sides = [np.c_[np.full(len(y), x), y, z] for x in (-0.5 * thick, 0.5 * thick)]
    r = np.concatenate(sides)
    normal = np.zeros_like(r)
    normal[:, 0] = np.sign(r[:, 0])
    n = len(r)
    zero = np.zeros(n)
    return FilteredPoints(
        r,
        normal,
        zero,
        np.zeros((n, 6), np.float32),
        np.zeros(n, np.int64),
        np.arange(n),
        np.zeros((n, 2)),
    )


def test_a_gradient_goes_to_the_survey_whole():
    survey, rng = plates(0.08), np.random.default_rng(1)
    r = survey.r_map + rng.uniform(-0.02, 0.02, survey.r_map.shape)
    gradient = rng.normal(size=r.shape)
    moved = on_survey(r, survey.normal, gradient, survey, 0.3)
    assert moved.gradient.sum(axis=0) == pytest.approx(gradient.sum(axis=0), abs=1e-12)
    assert moved.apart == 0.0 and moved.apart_m < 0.05


def test_what_the_survey_has_no_side_for_is_counted():
    survey = plates(0.08)
    r = np.array([[0.0, 1.0, 1.02], [5.0, 1.0, 0.5], [0.04, 1.0, 0.5]])  # its top; far off; a side
    normal = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    gradient = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert on_survey(r, normal, gradient, survey, 0.3).apart == pytest.approx(0.75)
    nothing = on_survey(r, normal, 0.0 * gradient, survey, 0.3)
    assert nothing.apart == 0.0 and not nothing.gradient.any()


def test_what_is_low_is_no_object_and_what_is_far_no_return():
    rng = np.random.default_rng(2)
    xy = rng.uniform(-3.0, 3.0, (6000, 2))
    z = np.where(np.abs(xy).max(axis=1) < 0.5, 0.8, 0.0)
    z = np.where(np.abs(xy - [2.0, 2.0]).max(axis=1) < 0.4, 0.05, z)
    points = BodyPoints(np.c_[xy, z], None, None, np.full(6000, 0.003), 0.003)
    ground = design_surface([0.0])
    assert len(objects_on(points, ground, 0.01).records) == 2
    found = objects_on(points, ground, 0.1)
    assert len(found.records) == 1 and found.label.max() == 0
    assert (z[found.label == 0] == 0.8).all() and (found.label[z == 0.05] == -1).all()
    with pytest.raises(VolumeError) as caught:
        objects_on(points, ground, 2.0)
    assert caught.value.reason == "volume_no_body"
    near = around((np.array([[-1.0, -1.0], [1.0, 1.0]]),), 0.5, points.r)
    assert np.abs(near[:, :2]).max() < 1.5 and len(near) > 1000
    assert len(around((), 0.5, points.r)) == 6000


def test_nodes_refuse_bodies():
    live = pytest.importorskip("ladar_volume.nodes.declared_parameters").live
    assert live(Parameters()) == Parameters()
    with pytest.raises(ConfigurationError, match="replay"):
        live(Parameters.read({"volume": {"kind": "bodies"}}))

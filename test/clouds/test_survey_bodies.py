"""Closed bodies of a survey: gradients find the survey's own points, sides apart."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ladar_volume.clouds.body_points import BodyPoints
from ladar_volume.clouds.cloud_bodies import cloud_bodies
from ladar_volume.clouds.sampling.even_points import even_rows, sparse_spacing
from ladar_volume.clouds.survey.return_store import ReturnStore
from ladar_volume.clouds.survey.survey_bodies import (
    meshed_objects,
    objects_on,
    points_near_outlines,
)
from ladar_volume.clouds.survey.survey_gradient import on_survey
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.body_parameters import BodyParameters
from ladar_volume.model.errors import SurfaceError, VolumeError
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
    assert len(objects_on(points, ground, 0.01)[0].records) == 2
    found, even = objects_on(points, ground, 0.1)
    assert set(even) == {-1, 0} and (found.label[even == 0] == 0).all()
    assert len(found.records) == 1 and found.label.max() == 0
    assert (z[found.label == 0] == 0.8).all() and (found.label[z == 0.05] == -1).all()
    with pytest.raises(VolumeError) as caught:
        objects_on(points, ground, 2.0)
    assert caught.value.reason == "volume_no_body"
    near = points_near_outlines((np.array([[-1.0, -1.0], [1.0, 1.0]]),), 0.5, points.r)
    assert np.abs(near[:, :2]).max() < 1.5 and len(near) > 1000
    assert len(points_near_outlines((), 0.5, points.r)) == 6000


def lined_box(rng, height=1.2, lines=9, noise=0.0):
    """A box of 2 x 1.5 m as flown over: a dense roof, walls in a few close lines of points, ground;
    points and normals.
    """
    n = 12000
    roof = np.c_[rng.uniform(-1, 1, n), rng.uniform(-0.75, 0.75, n), np.full(n, height)]
    parts, normals = [roof], [np.tile([0.0, 0.0, 1.0], (n, 1))]
    level = np.linspace(0.02, height - 0.02, lines)
    for axis, side, half in ((0, 1.0, 0.75), (0, -1.0, 0.75), (1, 1.0, 1.0), (1, -1.0, 1.0)):
        along, z = (a.ravel() for a in np.meshgrid(np.arange(-half, half, 0.012), level))
        at = np.zeros((len(z), 3))
        at[:, axis], at[:, 1 - axis], at[:, 2] = side * (1.0, 0.75)[axis], along, z
        turned = np.zeros((len(z), 3))
        turned[:, axis] = side
        parts.append(at + rng.uniform(-0.004, 0.004, at.shape) * (1.0 - np.abs(turned)))
        normals.append(turned)
    xy = rng.uniform(-3.0, 3.0, (30000, 2))
    xy = xy[(np.abs(xy) > (1.0, 0.75)).any(axis=1)]
    parts.append(np.c_[xy, np.zeros(len(xy))])
    normals.append(np.tile([0.0, 0.0, 1.0], (len(xy), 1)))
    r, normal = np.concatenate(parts), np.concatenate(normals)
    return r + noise * rng.normal(size=(len(r), 1)) * normal, normal


def test_a_wall_in_a_few_lines_is_closed_as_the_dense_roof_is():
    r, normal = lined_box(np.random.default_rng(4))
    points = BodyPoints(r, normal, np.zeros(len(r), bool), np.full(len(r), 0.003), 0.003)
    ground = design_surface([0.0])
    found, even = objects_on(points, ground, 0.1)
    assert len(found.records) == 1
    made = cloud_bodies(r, normal, points.curved, even, ground)
    assert made.bodies[0].volume_m3 == pytest.approx(2.0 * 1.5 * 1.2, rel=2e-4)
    with pytest.raises(SurfaceError):  # all of the points: edges that suit the roof
        cloud_bodies(r, normal, points.curved, found.label, ground)


def test_a_face_that_few_returns_met_is_closed_by_a_coarser_mesh():
    r, normal = lined_box(np.random.default_rng(4), lines=30)
    side = np.flatnonzero((r[:, 0] == -1.0) & (normal[:, 0] != 0.0))
    near = r[side, 1] // 0.26 + 100.0 * (r[side, 2] // 0.26)
    kept = np.union1d(np.setdiff1d(np.arange(len(r)), side), side[np.unique(near, True)[1]])
    r, normal = r[kept], normal[kept]
    points = BodyPoints(r, normal, np.zeros(len(r), bool), np.full(len(r), 0.003), 0.003)
    ground, options = design_surface([0.0]), BodyParameters()
    fine = objects_on(points, ground, 0.1)[1]
    with pytest.raises(SurfaceError):
        cloud_bodies(r, normal, points.curved, fine, ground, options)
    found, made = meshed_objects(points, ground, 0.1, options)
    assert len(found.records) == len(made.bodies) == 1
    assert made.bodies[0].volume_m3 == pytest.approx(2.0 * 1.5 * 1.2, rel=2e-3)


def test_even_rows_hold_a_distance_whatever_the_numbering():
    rng = np.random.default_rng(5)
    dense, sparse = rng.uniform(0.0, 1.0, (3000, 3)), rng.uniform(1.0, 4.0, (800, 3))
    r = np.concatenate([dense, sparse, dense[:50]])  # copies too
    rows = even_rows(r, 0.08)
    near = cKDTree(r[rows])
    assert near.query(r[rows], 2)[0][:, 1].min() > 0.08  # none too near
    assert near.query(r)[0].max() <= 0.08  # and every other one near to one of them
    mixed = rng.permutation(len(r))
    again = r[mixed][even_rows(r[mixed], 0.08)]
    assert np.array_equal(np.unique(again, axis=0), np.unique(r[rows], axis=0))
    assert sparse_spacing(r) > 3.0 * sparse_spacing(dense)
    assert sparse_spacing(r[:1]) == 0.0 and len(even_rows(r[:0], 0.1)) == 0


def test_what_is_kept_of_returns_depends_on_their_set_alone():
    rng = np.random.default_rng(6)
    r = np.concatenate([rng.normal(0.0, 0.3, (20000, 3)), rng.uniform(-2.0, 2.0, (3000, 3))])
    r = np.concatenate([r, r[:500]])
    whole = ReturnStore(0.2, 40)
    whole.add(r)
    parts = ReturnStore(0.2, 40)
    for k, part in enumerate(np.array_split(rng.permutation(r), 17)):
        parts.add(part)
        if k == 8:
            early = parts.copy()
            parts.returns()
    kept = whole.returns()
    assert np.array_equal(kept, parts.returns()) and len(early.returns()) < len(kept)
    _, count = np.unique(np.floor(kept / 0.2), axis=0, return_counts=True)
    _, before = np.unique(np.floor(r / 0.2), axis=0, return_counts=True)
    assert np.array_equal(count, np.minimum(before, 40)) and before.max() > 300
    # a fair sample: neither side of a full cell is left out
    full = kept[(np.floor(kept / 0.2) == 0).all(axis=1)]
    assert len(full) == 40 and 8 < np.count_nonzero(full[:, 0] > 0.1) < 32
    assert len(ReturnStore(0.2).returns()) == 0

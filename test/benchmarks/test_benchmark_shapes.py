"""The synthetic sets: distances against dense samples and closed forms, labels, and the figures of
results that are known.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import shapes, truth

SETS = shapes.every(3)
NAMES = [shape.name for shape in SETS]


def result(r, index, n):
    index = np.asarray(index)
    return SimpleNamespace(r=r, index=index, outliers=np.setdiff1d(np.arange(n), index))


@pytest.mark.parametrize("shape", SETS, ids=NAMES)
def test_noise_stays_in_its_range_and_feet_lie_on_the_surface(shape):
    d = shape.distance(shape.points)
    reach = shapes.NOISE_M * (np.sqrt(3) if shape.name == "cube on ground" else 1)
    assert d[shape.from_surface].max() <= reach + 1e-12
    assert np.count_nonzero(~shape.from_surface) == shapes.OUTLIERS
    foot, normal = shape.foot(shape.points)
    np.testing.assert_allclose(shape.distance(foot), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-12)


@pytest.mark.parametrize("shape", SETS, ids=NAMES)
def test_the_same_seed_gives_the_same_set_and_another_a_different_one(shape):
    at = NAMES.index(shape.name)
    np.testing.assert_array_equal(shapes.every(3)[at].points, shape.points)
    assert not np.array_equal(shapes.every(4)[at].points, shape.points)


def test_counts_of_the_thesis():
    counts = {shape.name: np.count_nonzero(shape.from_surface) for shape in SETS}
    assert (counts["sphere"], counts["cube"], counts["cube on ground"]) == (2200, 5800, 5800)


@pytest.mark.parametrize("angle", [60, 90, 120, 150])
def test_a_dihedral_encloses_its_angle(angle):
    shape = shapes.dihedral(0, angle)
    a = shape.normal[0]
    b = shape.normal[np.argmin(shape.normal @ a)]
    np.testing.assert_allclose(np.degrees(np.arccos(a @ b)), 180 - angle, atol=1e-6)


def test_distance_to_a_cube_has_a_closed_form_inside_and_outside():
    shape = shapes.cube(0)
    p = np.random.default_rng(0).uniform(-1, 1, (5000, 3))
    q = np.abs(p) - 0.5
    expected = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    np.testing.assert_allclose(shape.signed(p), expected, atol=1e-12)


def test_the_sign_is_right_around_an_acute_edge():
    """In front of a 60 degree edge one of the two faces is seen from behind: the point is outside
    all the same.
    """
    shape = shapes.dihedral(5, 60)
    a = shape.normal[0]
    b = shape.normal[np.argmin(shape.normal @ a)]
    edge = (
        shape.points[0] - shape.foot(shape.points[:1])[0][0]
    )  # any vector: only its part along the edge is used
    along = np.cross(a, b) / np.linalg.norm(np.cross(a, b))
    at = along * (edge @ along)
    for out in (a, b, a + b, a + 0.05 * b, b + 0.05 * a):
        assert shape.signed((at + 0.03 * out)[None])[0] > 0
    assert shape.signed((at - 0.03 * (a + b))[None])[0] < 0


@pytest.mark.parametrize("shape", SETS[2:], ids=NAMES[2:])
def test_distance_to_polygons_agrees_with_a_dense_sample(shape):
    rng = np.random.default_rng(1)
    queries = shape.points[rng.choice(len(shape.points), 40, replace=False)]
    foot = shape.foot(shape.points)[0]
    nearest = np.min(np.linalg.norm(queries[:, None] - foot[None], axis=2), axis=1)
    # feet of other points are on the surface: none is nearer than the foot
    assert np.all(shape.distance(queries) <= nearest + 1e-12)


def test_perfect_result_scores_perfectly():
    shape = shapes.cube(1)
    index = np.flatnonzero(shape.from_surface)
    figures = shapes.score(
        shape, result(shape.foot(shape.points)[0][index], index, len(shape.points))
    )
    assert figures["rms_mm"] < 1e-9 and figures["edge_rms_mm"] < 1e-9
    assert (
        figures["false_removed_pct"] == 0
        and figures["far_removed_pct"] == 100
        and figures["unaccounted"] == 0
    )


def test_raw_points_score_the_noise():
    shape = shapes.sphere(2)
    everything = np.arange(len(shape.points))
    figures = shapes.score(shape, result(shape.points, everything, len(everything)))
    assert figures["rms_mm"] == pytest.approx(50 / np.sqrt(3), rel=0.05)
    assert figures["far_removed_pct"] == 0 and np.isnan(figures["edge_rms_mm"])


def test_a_shrunk_sphere_has_that_bias():
    shape = shapes.sphere(2)
    index = np.flatnonzero(shape.from_surface)[:1000]
    r = 0.998 * shape.foot(shape.points[index])[0]
    figures = shapes.score(shape, result(r, index, len(shape.points)))
    assert figures["bias_mm"] == pytest.approx(-2.0, abs=1e-9)
    assert figures["false_removed_pct"] == pytest.approx(100 * 1200 / 2200)


def test_a_point_kept_twice_or_kept_and_removed_is_refused():
    shape = shapes.sphere(2)
    with pytest.raises(ValueError):
        shapes.score(
            shape,
            SimpleNamespace(
                r=shape.points[[0, 0]], index=np.array([0, 0]), outliers=np.zeros(0, int)
            ),
        )
    with pytest.raises(ValueError):
        shapes.score(
            shape, SimpleNamespace(r=shape.points[:1], index=np.array([0]), outliers=np.array([0]))
        )


def test_samples_are_uniform_by_area():
    faces = truth.box_faces(np.zeros(3), np.array([1.0, 2.0, 3.0]))
    _, normals = truth.sample_polygons(faces, 60_000, np.random.default_rng(0))
    share = [np.mean(np.abs(normals[:, axis]) > 0.5) for axis in range(3)]
    np.testing.assert_allclose(share, np.array([6, 3, 2]) / 11, atol=0.01)

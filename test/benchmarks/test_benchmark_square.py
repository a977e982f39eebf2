"""The synthetic square: counts, classes, exact distances and the figures of a result that is
known.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import square as sq

WHOLE = sq.square(30_000, seed=2)


def test_counts_classes_and_seeds():
    assert len(WHOLE.points) == len(WHOLE.label) == 30_000
    counts = np.bincount(WHOLE.label, minlength=len(sq.CLASSES))
    assert counts[sq.CROWN] == 3000 and counts[sq.OUTLIER] == sq.OUTLIERS and np.all(counts > 0)
    np.testing.assert_array_equal(sq.square(30_000, seed=2).points, WHOLE.points)
    assert not np.array_equal(sq.square(30_000, seed=3).points, WHOLE.points)


def test_noise_stays_in_its_range_and_is_uniform_in_every_class():
    d = WHOLE.distance(WHOLE.points)
    for kind in (sq.GROUND, sq.BENCH, sq.FOUNTAIN, sq.LAMP, sq.TRUNK):
        mine = d[WHOLE.label == kind]
        assert mine.max() <= sq.NOISE_M + 1e-12
        assert sq.rms_mm(mine) == pytest.approx(28.5, abs=3)


def test_skipping_far_bodies_changes_no_distance():
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [WHOLE.points[:1000], rng.uniform([-15, -15, -1], [15, 15, 7], (1000, 3))]
    )
    p = WHOLE.level(points)
    plain = np.abs(p[:, 2])
    for body in sq.BODIES:
        plain[body.covers(p[:, 0], p[:, 1])] = np.inf
    for body in sq.BODIES:
        plain = np.minimum(plain, body.distance(p))
    np.testing.assert_array_equal(WHOLE.distance(points), plain)


@pytest.mark.parametrize("body", sq.BODIES[5:], ids=lambda body: sq.CLASSES[body.kind])
def test_samples_lie_on_their_body_and_normals_point_outwards(body):
    at, normal = body.sample(500, np.random.default_rng(1))
    np.testing.assert_allclose(body.distance(at), 0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(body.distance(at + 1e-4 * normal), 1e-4, rtol=0.3)


def test_areas_have_closed_forms():
    ring = next(body for body in sq.BODIES if body.kind == sq.FOUNTAIN)
    assert ring.area() == pytest.approx(2 * np.pi * 7.6 * 0.5 + np.pi * (16 - 3.6**2))
    assert ring.footprint() == pytest.approx(np.pi * (16 - 3.6**2))
    at, _ = ring.sample(40_000, np.random.default_rng(0))
    outer = np.mean(np.hypot(at[:, 0], at[:, 1] + 5) > 4 - 1e-9)
    assert outer == pytest.approx(2 * np.pi * 4 * 0.5 / ring.area(), abs=0.01)


def test_distance_to_a_post_and_into_the_fountain():
    x, y = sq.LAMPS[0]
    points = np.array(
        [[x + 0.3, y, 2.0], [x, y, 4.7], [0.0, -5.0, 0.3], [3.8, -5.0, 0.7], [3.8, -5.0, 0.2]]
    )
    expected = [0.2, 0.7, 0.3, 0.2, 0.2]
    np.testing.assert_allclose(WHOLE.distance(points @ sq.TILT.T), expected, atol=1e-9)


def test_a_perfect_and_a_raised_paving():
    ground = np.flatnonzero(WHOLE.label == sq.GROUND)
    flat = WHOLE.level(WHOLE.points[ground])
    rest = np.setdiff1d(np.arange(len(WHOLE.points)), ground)
    for height in (0.0, 0.002):
        flat[:, 2] = height
        figures = sq.score(WHOLE, SimpleNamespace(r=flat @ sq.TILT.T, index=ground, outliers=rest))
        assert figures["ground_bias_mm"] == pytest.approx(1e3 * height, abs=1e-9)
        assert figures["ground_rms_mm"] == pytest.approx(1e3 * height, abs=0.01)
        assert (
            figures["ground_kept_pct"] == 100
            and figures["crown_kept_pct"] == 0
            and figures["far_removed_pct"] == 100
        )


def test_windows_keep_density_and_labels():
    part = sq.window(WHOLE, 6.0)
    assert np.all(np.abs(part.points[:, :2]) <= 3.0)
    assert {sq.GROUND, sq.BENCH, sq.FOUNTAIN} <= set(part.label)

"""A real box with 25 and with 100 balls: the growth of the bulk in two independent ways; skipped
where the recordings are not.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import ball_box


@pytest.mark.skipif(not ball_box.there(), reason=f"no recordings in {ball_box.FOLDER}")
def test_two_ways_agree_with_the_yardstick_within_three_percent():
    many, few = (p[ball_box.highest(p)] for p in ball_box.clouds())
    plan, sigma = ball_box.by_prismoids(many, few)
    (one, sigma_one, pole, rim), (two, sigma_two, _, _) = (
        ball_box.by_tetrahedra(many),
        ball_box.by_tetrahedra(few),
    )
    yardstick = 1e-3 * ball_box.YARDSTICK_L
    assert plan == pytest.approx(yardstick, rel=0.03) and one - two == pytest.approx(
        yardstick, rel=0.03
    )
    assert plan == pytest.approx(
        one - two, rel=0.01
    )  # they share the points, but neither triangulation nor integral
    assert pole < 1e-9 * one and 1.2 < rim < 1.4
    assert 0 < sigma < 1e-4 and 0 < np.hypot(sigma_one, sigma_two) < 1e-4


def test_absent_recordings_are_said_to_be(monkeypatch):
    monkeypatch.setattr(ball_box, "FILES", {25: ball_box.FOLDER / "none.pcd"})
    assert not ball_box.there() and "data" in ball_box.run()


def test_a_box_of_known_volume_by_both_ways():
    """A plane top 10 cm above the floor, 40 by 24 cm, seen from above; the highest points of its
    cells alone make it a little smaller.
    """
    rng = np.random.default_rng(0)
    top = np.column_stack(
        [rng.uniform(-0.2, 0.2, 6000), rng.uniform(-0.12, 0.12, 6000), np.zeros(6000)]
    )
    corners = np.array([[x, y, 0.0] for x in (-0.2, 0.2) for y in (-0.12, 0.12)])
    top = np.concatenate([top, corners]) + np.array([0.0, 0.0, ball_box.FLOOR_M + 0.1])
    low = top * [1, 1, 0] + [0.0, 0.0, ball_box.FLOOR_M + 0.04]
    assert ball_box.by_prismoids(top, low)[0] == pytest.approx(0.4 * 0.24 * 0.06, rel=1e-9)
    assert ball_box.by_tetrahedra(top)[0] == pytest.approx(0.4 * 0.24 * 0.1, rel=1e-3)
    chosen = ball_box.highest(top * [1, 1, 0] + rng.uniform(0, 1, (len(top), 1)) * [0, 0, 1])
    assert len(chosen) < 0.75 * len(top) and len(np.unique(chosen)) == len(chosen)

"""A cloud whose heights are in another column than z is refused."""

import numpy as np
import pytest

from ladar_volume.clouds.sampling.height_axis import check_height_axis, thickness
from ladar_volume.model.errors import InputError


def pile(seed, n=6000):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-12.0, 12.0, (n, 2))
    z = 3.0 * np.clip(1.0 - np.hypot(*xy.T) / 6.0, 0.0, None) + 0.3 * np.sin(xy[:, 0])
    return np.c_[xy, z + rng.normal(0.0, 0.02, n)]


@pytest.mark.parametrize("seed", range(3))
def test_heights_in_z_pass(seed):
    r = pile(seed)
    check_height_axis(r)
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(2, 2)))[0]
    check_height_axis(np.c_[r[:, :2] @ turn, r[:, 2]])


@pytest.mark.parametrize(("order", "column"), [([0, 2, 1], "column y"), ([2, 0, 1], "column x")])
def test_heights_in_another_column_are_refused(order, column):
    with pytest.raises(InputError, match=column) as error:
        check_height_axis(pile(1)[:, order])
    assert error.value.reason == "input_height_axis" and error.value.value > 10.0


def test_closed_bodies_and_few_points_pass():
    rng = np.random.default_rng(5)
    ball = rng.normal(size=(5000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    check_height_axis(ball)
    check_height_axis(pile(2, 30)[:, [0, 2, 1]])
    check_height_axis(np.zeros((500, 3)))
    check_height_axis(np.c_[np.arange(900.0), np.zeros((900, 2))])


def test_thickness_by_a_loop_over_cells():
    r = pile(3, 2000)
    flat = r[:, :2] - r[:, :2].min(axis=0)
    size = np.sqrt(np.ptp(flat, axis=0).prod() * 10.0 / len(r))
    cells = {}
    for (x, y), z in zip(flat, r[:, 2], strict=True):
        cells.setdefault((int(x // size), int(y // size)), []).append(z)
    expected = np.mean([np.std(z) for z in cells.values() if len(z) >= 3])
    assert thickness(r, 2) == pytest.approx(expected, rel=1e-9)

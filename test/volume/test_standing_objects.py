"""What stands on a pile or beside it is taken out, named, and the surface below bridged."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from ladar_volume.volume.field_checks.object_removal import mixed_patches
from ladar_volume.volume.field_checks.standing_objects import (
    any_step,
    between_parts,
    standing_parts,
)
from test.scenes.cone_pile import TRUE_M3, estimated, estimator_of, names, pile


def with_boxes(*boxes):
    """The pile with boxes (x, y, length, width, height above the surface)."""

    def height(x, y):
        z = pile(x, y)
        for x0, y0, long, wide, high in boxes:
            hit = (np.abs(x - x0) < long / 2) & (np.abs(y - y0) < wide / 2)
            z = np.where(hit, pile(np.array(x0), np.array(y0)) + high, z)
        return z

    return height


@pytest.mark.parametrize(
    "box", [(4.1, 0.0, 2.0, 1.5, 1.5), (1.5, -1.0, 1.6, 1.6, 2.0), (-4.5, 1.0, 1.4, 1.4, 1.0)]
)
def test_a_machine_is_taken_out_and_named(box):
    v = estimated(with_boxes(box)).volume
    one = v.objects[0]
    assert math.hypot(one.x_m - box[0], one.y_m - box[1]) < 0.5
    assert one.high_m == pytest.approx(box[4], abs=0.7)
    assert abs(v.volume_m3 - TRUE_M3) < 3.0 * v.sigma_m3
    assert v.sigma_m3 < 0.05 * TRUE_M3
    assert "object" in {doubt.name for doubt in v.verdict.doubts}


def test_what_is_to_count_counts():
    box = (4.1, 0.0, 2.0, 1.5, 1.5)
    counted = estimated(with_boxes(box), objects="count")
    assert counted.volume.objects == () and counted.volume.volume_m3 > TRUE_M3 + 2.0
    assert "object" not in names(counted)


def test_people_and_a_mast_are_taken_out():
    boxes = [(1.0, 1.5, 0.5, 0.5, 1.7), (-2.0, 0.5, 0.5, 0.5, 1.7), (0.0, -3.0, 0.5, 0.5, 3.0)]
    v = estimated(with_boxes(*boxes)).volume
    assert len(v.objects) == 3 and all(one.inside for one in v.objects)
    assert abs(v.volume_m3 - TRUE_M3) < 3.0 * v.sigma_m3


def test_a_body_on_steep_faces_is_the_body():
    def box(x, y):
        return np.where((np.abs(x) < 2.5) & (np.abs(y) < 2.0), 1.5, 0.0 * x)

    v = estimated(box).volume
    assert v.objects == () and v.volume_m3 > 28.0


def test_the_ground_beside_a_pit_is_no_object():
    """Parts: 0 the ground, 1 a pit's floor, 2 a crate on it: the crate lies above all its edges."""
    low, high = np.array([1, 1, 1, 1]), np.array([0, 0, 2, 2])
    steps = between_parts(low, high, np.ones(4, int), np.array([500, 60, 5]))
    assert standing_parts(steps, np.array([True, False, False])).tolist() == [False, False, True]


def test_a_pile_against_a_wall_has_the_strip_below_it_in_sigma():
    """The pile ends at a wall 40 cm wide, which is taken out; whether the pile goes on below it
    nobody sees.
    """
    at = 1.5

    def height(x, y):
        z = np.where(x < at, pile(x, y), 0.0)
        return np.where(np.abs(x - at - 0.2) < 0.21, 3.0, z)

    v = estimated(height).volume
    u = (np.arange(800) + 0.5) / 100.0 - 4.0
    x, y = np.meshgrid(u, u)
    true_m3 = float(pile(x, y)[x < at].sum() * 1e-4)
    assert len(v.objects) == 1 and v.objects[0].high_m > 2.0
    # of the strip, some 5 m long and up to 1.2 m high, half is counted or is not
    assert 0.1 < v.budget_m6["unseen"] ** 0.5 < 2.5
    assert abs(v.volume_m3 - true_m3) < 2.0 * v.sigma_m3
    # a machine in the open hides next to nothing
    beside = estimated(with_boxes((5.5, 0.0, 1.0, 1.0, 1.5))).volume
    assert beside.budget_m6.get("unseen", 0.0) ** 0.5 < 0.02


def with_floats(share, objects="remove"):
    """The pile with patches at the toe on one side lifted by 40 cm: a few scattered returns each,
    or, with a share of 1, as many as anywhere. Boxes stand on it, too.
    """
    e = estimator_of(with_boxes((-2.0, 0.5, 0.5, 0.5, 1.7)), objects=objects)
    patches, points = e.store.patches, e.store.points
    off = patches.centre - [3.6, 0.0, 0.0]
    patches.used[:] = 100
    patches.sigma[:] = 0.01
    hit = np.abs(off[:, :2]).max(axis=1) < 0.8
    patches.used[hit], patches.sigma[hit] = 100 * share, 0.12
    points.r_map[np.isin(points.patch, patches.key[hit]), 2] += 0.4
    return e, int(np.count_nonzero(np.isin(points.patch, patches.key[hit])))


def test_patches_of_mixed_returns_leave_a_gap_and_are_counted():
    e, count = with_floats(0.1)
    v = e.estimate().volume
    assert e.screen_losses["point_mixed"] == count > 20
    assert len(v.objects) == 1 and v.seen_share < 1.0
    assert abs(v.volume_m3 - TRUE_M3) < 2.0 * v.sigma_m3
    for other in (with_floats(1.0)[0], with_floats(0.1, "count")[0]):
        assert other.estimate().volume.volume_m3 > v.volume_m3 + 0.3
        assert other.screen_losses["point_mixed"] == 0


def test_a_survey_that_scatters_everywhere_keeps_its_patches():
    few = SimpleNamespace(sigma=np.full(40, 0.01), used=np.full(40, 100))
    few.sigma[:5], few.used[:5] = [0.2, 0.2, 0.04, 0.06, 0.06], [20, 30, 20, 20, 24]
    assert np.flatnonzero(mixed_patches(few)).tolist() == [0, 3, 4]
    few.sigma[:] *= 10.0  # half of them, or all alike
    assert np.flatnonzero(mixed_patches(few)).tolist() == [0, 3, 4]
    few.sigma[:30] = 1.0
    assert not mixed_patches(few).any()


def test_few_returns_below_the_ground_may_make_more_patches_than_the_surface():
    """5 % of the returns came as much as 4 m from below: 29 ± 24 m³ were told of a pile of 143, as
    what is usual was told from patches alone, and most of them held such returns.
    """
    echoes = SimpleNamespace(sigma=np.full(100, 0.01), used=np.full(100, 200))
    echoes.sigma[:60], echoes.used[:60] = np.linspace(0.2, 0.9, 60), np.linspace(8, 20, 60)
    assert np.flatnonzero(mixed_patches(echoes)).tolist() == list(range(60))
    echoes.used[60:] = 15  # as many as the surface has: which is the surface?
    assert not mixed_patches(echoes).any()


def test_vertices_without_objects_have_their_sigma():
    """What a result writes beside its surface is as long as that surface."""
    e = estimator_of(with_boxes((4.1, 0.0, 2.0, 1.5, 1.5)))
    tin, epoch = e.estimate().tin, e.epoch()
    assert len(tin.vertices) < len(epoch.tin.vertices)
    assert len(epoch.sigma_z(tin)) == len(tin.vertices)


@pytest.mark.parametrize("seed", range(6))
def test_a_step_is_found_as_by_arrays(seed):
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.0, 1.0, (30, 3)) * [1.0, 1.0, 0.3 * seed]
    t = rng.integers(0, 30, (40, 3)).astype(np.int32)
    d = r[t] - r[np.roll(t, -1, axis=1)]
    rise, length = np.abs(d[..., 2]), np.linalg.norm(d[..., :2], axis=-1)
    for step, slope in ((0.25, 1.4), (0.8, 3.0), (1.3, 40.0)):
        assert any_step(t, r, step, slope) == ((rise > step) & (rise > slope * length)).any()

"""What the model does not know shows: gaps, cuts, further bodies, walls and ground on one side."""

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.volume.field_checks.gap_kriging import (
    ObservedPoints,
)
from ladar_volume.volume.field_checks.unseen_surface import (
    unseen_surface,
)
from test.scenes.cone_pile import TRUE_M3, estimated, names, pile


def square(x0, y0, side):
    return lambda x, y: (np.abs(x - x0) > side / 2) | (np.abs(y - y0) > side / 2)


def test_a_whole_pile_is_sound_and_wholly_seen():
    v = estimated().volume
    assert v.verdict.sound, v.verdict
    assert v.seen_share == 1.0 and v.gaps == () and "unseen" not in v.budget_m6


@pytest.mark.parametrize(
    ("x", "y", "side"),
    [(0.0, 0.0, 2.0), (0.3, 0.2, 3.0), (2.0, 0.5, 2.5), (4.0, 0.0, 3.5), (-2.5, -3.0, 3.0)],
)
def test_a_hole_is_in_volume_and_sigma(x, y, side):
    v = estimated(seen=square(x, y, side)).volume
    error = v.volume_m3 - TRUE_M3
    assert abs(error) < 2.5 * v.sigma_m3
    assert v.sigma_m3 < 0.1 * TRUE_M3  # no bar of the size of the barn
    assert v.seen_share < 1.0 - 0.6 * side**2 / v.area_m2
    gap = v.gaps[0]
    assert math.hypot(gap.x_m - x, gap.y_m - y) < 0.5 * side
    assert v.sigma_m3**2 == pytest.approx(sum(v.budget_m6.values()))
    low, high = v.sigma_tau_range_m3
    assert low <= v.sigma_m3 <= high + 1e-9
    assert v.volume_m3 == pytest.approx(v.cut_m3 - v.fill_m3)


def test_a_large_hole_is_doubted_with_its_place():
    v = estimated(seen=square(0.3, 0.2, 3.0)).volume
    (doubt,) = (d for d in v.verdict.doubts if d.name == "unseen")
    assert "survey that place" in doubt.text and doubt.value == pytest.approx(
        1.0 - v.seen_share, abs=1e-6
    )


def test_a_hole_in_a_given_outline_is_bridged():
    corner = [-6.0, -6.0, 6.0, -6.0, 6.0, 6.0, -6.0, 6.0]
    seen = square(1.0, 0.0, 3.0)
    v = estimated(seen=seen, outline="polygon", polygon_m=corner).volume
    assert v.area_m2 == pytest.approx(144.0)
    assert abs(v.volume_m3 - TRUE_M3) < 2.5 * v.sigma_m3
    assert "unseen" in v.budget_m6


def test_a_shadow_across_a_body_does_not_halve_it():
    v = estimated(seen=lambda x, y: np.abs(x - 0.5) > 1.0).volume
    assert abs(v.volume_m3 - TRUE_M3) < 2.5 * v.sigma_m3
    assert "unseen" in {d.name for d in v.verdict.doubts}


def test_a_body_cut_by_the_data_or_the_region_is_named():
    cut = estimated(seen=lambda x, y: x < 1.5)
    assert {"cut", "ground_one_sided"} <= names(cut)
    (doubt,) = (d for d in cut.volume.verdict.doubts if d.name == "cut")
    assert "what was seen" in doubt.text and doubt.value < TRUE_M3 - cut.volume.volume_m3
    cut = estimated(seen=lambda x, y: x < 1.5, region=(-10.0, -10.0, -5.0, 1.5, 10.0, 9.0))
    (doubt,) = (d for d in cut.volume.verdict.doubts if d.name == "cut")
    assert "georeference.region_m" in doubt.text


@pytest.mark.parametrize("at", [-0.5, 0.0, 2.0, 3.0])
def test_what_a_cut_took_is_in_sigma(at):
    v = estimated(seen=lambda x, y: x < at).volume
    missing = TRUE_M3 - v.volume_m3
    assert missing > 0.0 and "cut" in v.budget_m6
    assert 0.4 * v.sigma_m3 < missing < 2.0 * v.sigma_m3


def test_a_whole_pile_has_no_line_for_a_cut_and_an_outline_given_means_what_it_says():
    assert "cut" not in estimated().volume.budget_m6
    corner = [-6.0, -6.0, 1.0, -6.0, 1.0, 6.0, -6.0, 6.0]
    assert "cut" not in estimated(outline="polygon", polygon_m=corner).volume.budget_m6


def test_an_outline_through_the_body_is_named():
    corner = [-6.0, -6.0, 1.0, -6.0, 1.0, 6.0, -6.0, 6.0]
    assert "cut" in names(estimated(outline="polygon", polygon_m=corner))


def test_a_second_body_is_named_unless_it_counts():
    def two(x, y):
        return np.maximum(pile(x, y, (-4.5, 0.0)), pile(x, y, (5.5, 0.0), 3.0, 1.2))

    found = estimated(two, half=12.0)
    assert "further_bodies" in names(found)
    (doubt,) = (d for d in found.volume.verdict.doubts if d.name == "further_bodies")
    assert doubt.value == pytest.approx(math.pi * 9.0 * 1.2 / 3.0, rel=0.1)
    assert "further_bodies" not in names(estimated(two, half=12.0, bodies=0))


def test_a_wall_beside_a_pile_is_named_and_a_box_is_not():
    def walled(x, y):
        return np.maximum(pile(x, y), 2.5 * np.clip((x - 2.5) / 0.3, 0.0, 1.0) * (x < 4.0))

    def box(x, y):
        return 2.0 * np.clip((2.0 - np.maximum(np.abs(x), np.abs(y))) / 0.3 + 0.5, 0.0, 1.0)

    assert "wall" in names(estimated(walled))
    assert "wall" not in names(estimated(box))


def test_the_surface_of_a_gap_moves_with_its_surroundings():
    rng = np.random.default_rng(3)
    xy = rng.uniform(-6.0, 6.0, (3000, 2))
    xy = xy[np.abs(xy).max(axis=1) > 1.0]
    step = (np.arange(8) + 0.5) / 4.0 - 1.0
    place = np.stack([a.ravel() for a in np.meshgrid(step, step)], axis=1)
    weight, apart = np.full(64, 1.0 / 16.0), np.full(64, 0.15)

    def found(height, chord=0.0):
        r = np.column_stack([xy, height(xy)])
        return unseen_surface(
            ObservedPoints.of(r, np.full(len(r), 1e-6), 0.2),
            place,
            weight,
            apart,
            np.full(64, chord / 4.0),
        )

    plane = found(lambda p: 1.0 + 0.2 * p[:, 0] - 0.1 * p[:, 1], 4.0)
    assert plane.volume_m3 == pytest.approx(4.0, abs=1e-6) and plane.variance_m6 < 1e-3
    rough = np.column_stack([np.sin(1.1 * xy[:, 0]), np.cos(1.3 * xy[:, 1])]).sum(axis=1)
    one, two = found(lambda p: 0.2 * rough, 0.0), found(lambda p: 0.2 * rough + 3.0, 12.0)
    assert two.volume_m3 - one.volume_m3 == pytest.approx(12.0)
    assert two.variance_m6 == pytest.approx(one.variance_m6, rel=1e-6) and one.trials > 5


def test_doubts_of_a_body_are_plain_values():
    v = dataclasses.replace(estimated(seen=lambda x, y: x < 1.5).volume)
    told = v.verdict.as_dict()
    assert told["status"] == "doubtful" and all(r["text"] for r in told["reasons"])


def on_ground(of):
    return lambda x, y: pile(x, y) + of(x, y)


def test_ground_that_is_no_plane_is_in_sigma_and_named():
    bowl = estimated(on_ground(lambda x, y: 0.004 * (x**2 + y**2)))
    pit = on_ground(lambda x, y: -0.2 * (np.hypot(x, y) < 6.2))
    pad = estimated(pit, object_height_m=0.3, ground_ring_m=8.0)
    for found, name in ((bowl, "base_bends"), (pad, "base_toe")):
        v = found.volume
        error = v.volume_m3 - TRUE_M3
        assert name in names(found) and abs(error) > 1.0
        assert abs(error) < 3.0 * v.sigma_m3 and v.budget_m6["base_model"] > 0.0
        (doubt,) = (d for d in v.verdict.doubts if d.name == name)
        assert f"{v.volume_m3:.5g} m³" in doubt.text  # both volumes are named
        assert f"{v.volume_m3 + doubt.value:.5g} m³" in doubt.text
        assert doubt.value * error < 0.0  # towards the truth


def test_a_slope_is_no_trouble_and_few_places_of_ground_widen_the_interval():
    assert estimated(on_ground(lambda x, y: 0.05 * x - 0.02 * y)).volume.verdict.sound
    waves = estimated(on_ground(lambda x, y: 0.02 * np.sin(0.9 * x) * np.cos(0.8 * y + 0.4)))
    assert waves.volume.coverage_factor > 1.97
    v = waves.volume
    half = v.coverage_factor * v.sigma_m3
    assert v.interval_m3 == pytest.approx((v.volume_m3 - half, v.volume_m3 + half))


@pytest.mark.parametrize(("level", "doubted"), [(0.12, True), (-0.12, True), (0.0, False)])
def test_a_level_beside_the_ground_is_doubted_with_both_volumes(level, doubted):
    v = estimated(base="level", level_m=level, object_height_m=0.3).volume
    found = [d for d in v.verdict.doubts if d.name == "base_level"]
    assert bool(found) == doubted
    assert (v.budget_m6.get("base_model", 0.0) > 0.0) == doubted
    if doubted:
        assert found[0].value == pytest.approx(-level, abs=0.01)
        assert abs(v.volume_m3 - TRUE_M3) < 1.5 * v.sigma_m3


def test_a_level_so_far_below_that_all_of_the_site_rises_above_it_is_doubted():
    """The outline is the edge of the survey: there is no ground beyond it."""
    low = dict(base="level", level_m=-0.4, object_height_m=0.3)
    v = estimated(**low).volume
    assert v.volume_m3 > 100.0
    (found,) = (d for d in v.verdict.doubts if d.name == "base_level")
    assert found.value == pytest.approx(0.4, abs=0.01)
    assert "base_level" not in names(estimated(outline="all", **low))

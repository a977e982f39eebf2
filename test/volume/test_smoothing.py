"""What the filter's fits smooth away is taken out of the volume, from cut and from fill."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from mapped_sheet import mapped, platform

from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.model.parameters import Parameters
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.uncertainty.smoothing import cut_shift, own_shift
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.measured_body import solid_of
from ladar_volume.volume.volume_loads import result_gradients

HALF, SLOPE, LIFT = 4.0, 0.3, 2.0
SQUARE = [-HALF, -HALF, HALF, -HALF, HALF, HALF, -HALF, HALF]
#: Of the trough above or below the level, within the square.
EXACT = 4.0 * HALF**2 * (LIFT + SLOPE * HALF / 2.0)


def estimator(up, seed, count=20_000, slope=SLOPE, lift=LIFT):
    """A trough with a sharp bottom (up = 1), or its mirror image below the level (-1)."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-HALF - 1.0, HALF + 1.0, (count, 2))
    z = lift + slope * np.abs(xy[:, 0] - 0.1) + 0.01 * rng.standard_normal(count)
    parameters = Parameters.read(
        {
            "filter": {"radius_m": 0.5},
            "volume": {
                "base": "level",
                "level_m": 0.0,
                "outline": "polygon",
                "polygon_m": SQUARE,
            },
        }
    )
    f, e = SurfaceFilter(parameters), VolumeEstimator(parameters)
    f.add_platform(platform())
    f.add(mapped(np.c_[xy, up * z]))
    e.add_platform(platform())
    e.add(f.finish())
    return e


def without(e):
    """The same surface, with nothing known of what was smoothed away."""
    nothing = SimpleNamespace(points=e.store.points, patches=e.store.patches)
    none = np.zeros_like(nothing.patches.own_residual)
    nothing.patches = dataclasses.replace(nothing.patches, own_residual=none)
    other = VolumeEstimator(e.parameters)
    other.add_platform(platform())
    other.store = nothing
    return other


@pytest.mark.parametrize("up", (1.0, -1.0))
def test_a_sharp_trough_is_no_longer_rounded(up):
    before, after = [], []
    for seed in range(4):
        e = estimator(up, seed)
        v, plain = e.estimate().volume, without(e).estimate().volume
        # 0.1 m off the middle: half the difference of two squares less
        exact = up * (EXACT + 2.0 * HALF * SLOPE * 0.01)
        assert v.volume_m3 == pytest.approx(v.cut_m3 - v.fill_m3, abs=1e-9)
        assert abs((v.cut_m3, v.fill_m3)[up > 0.0]) < 1e-12
        assert plain.smoothing_m3 == 0.0 and plain.budget_m6["smoothing"] == 0.0
        assert v.volume_m3 == pytest.approx(plain.volume_m3 - v.smoothing_m3, abs=1e-9)
        before.append(up * (plain.volume_m3 - exact))
        after.append(up * (v.volume_m3 - exact))
        line = v.budget_m6["smoothing"]
        assert (v.smoothing_m3 / 3.0) ** 2 < line < v.smoothing_m3**2
        assert after[-1] ** 2 < 4.0 * (line + v.budget_m6["noise"])
    assert np.mean(before) > 0.02 and abs(np.mean(after)) < 0.5 * np.mean(before)


def test_it_is_the_gradient_times_the_residuals_point_by_point():
    e = estimator(1.0, 9, 15_000)
    v = e.estimate().volume
    survey, footing, _ = e.base(e.survey())
    solid = solid_of(survey.tin, footing.base, footing.part(0), e.parameters)
    gradient = result_gradients(
        survey.tin, footing.base, solid, len(survey.points), survey.surface
    )[:, 0]
    patches, total = survey.patches, 0.0
    of = {int(key): j for j, key in enumerate(patches.key)}
    for i in np.flatnonzero(gradient.any(axis=1)):
        j = of[int(survey.points.patch[i])]
        total += float(gradient[i] @ patches.normal[j]) * float(patches.own_residual[j])
    assert v.smoothing_m3 == pytest.approx(-total, rel=1e-6) and abs(total) > 0.01


def test_a_difference_of_two_surveys_has_that_of_both():
    """Sharp troughs that open upwards, one above the other: the upper one loses what the lower one
    gains.
    """
    new, previous = estimator(1.0, 3), estimator(1.0, 4, slope=0.3, lift=1.0)
    v = epoch_difference(new.epoch(), previous.epoch())[0].volume
    assert v.volume_m3 == pytest.approx(v.cut_m3 - v.fill_m3, abs=1e-9) and v.fill_m3 < 1e-9
    alone = [
        epoch_difference(a.epoch(), b.epoch())[0].volume
        for a, b in ((new, without(previous)), (without(new), previous))
    ]
    assert alone[0].smoothing_m3 > 0.01 and alone[1].smoothing_m3 < -0.01
    assert v.smoothing_m3 == pytest.approx(sum(a.smoothing_m3 for a in alone), rel=1e-9)
    none = epoch_difference(without(new).epoch(), without(previous).epoch())[0].volume
    assert v.volume_m3 == pytest.approx(none.volume_m3 - v.smoothing_m3, abs=1e-9)
    lines = [v.budget_m6[name] for name in ("smoothing", "smoothing_previous")]
    assert lines == [alone[0].budget_m6["smoothing"], alone[1].budget_m6["smoothing_previous"]]


@pytest.mark.parametrize(
    ("cut", "fill", "found", "net", "is_"),
    [
        (10.0, 5.0, 0.3, 0.1, 0.3),
        (10.0, 0.1, 0.5, 0.1, 0.2),  # fill would be -0.3
        (10.0, 0.0, 0.3, 0.1, 0.1),
        (0.2, 9.0, 0.5, 0.1, 0.2),  # cut would be -0.3
        (0.0, 9.0, -0.1, -0.1, -0.1),
    ],
)
def test_cut_and_fill_stay_at_zero_or_more(cut, fill, found, net, is_):
    s = cut_shift(cut, fill, found, net)
    assert s == pytest.approx(is_, abs=1e-12)
    after = cut - s, fill - (s - net)
    assert min(after) > -1e-12
    assert after[0] - after[1] == pytest.approx(cut - fill - net, abs=1e-12)


@pytest.mark.parametrize("count", [0, 1, 1024, 5000])
def test_the_shift_of_a_result_is_that_of_its_points_moved(count):
    rng = np.random.default_rng(count)
    normal, residual = rng.standard_normal((30, 3)), rng.normal(0, 1e-2, 30).astype(np.float32)
    patches = SimpleNamespace(normal=normal, own_residual=residual)
    gradient, row = rng.standard_normal((count, 3)), rng.integers(0, 30, count)
    moved = normal.astype(np.float32).astype(float)[row] * residual.astype(float)[row, None]
    found = own_shift(gradient, patches, row)
    assert found == pytest.approx(float((gradient * moved).sum()), rel=1e-10, abs=1e-15)
    patches.own_residual = residual[:0]
    assert own_shift(gradient, patches, row) == 0.0

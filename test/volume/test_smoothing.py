"""What the filter's fits smooth away is taken out of the volume, from cut and from fill."""

import dataclasses

import numpy as np
import pytest
from mapped_sheet import mapped, platform

from ladar_volume.model.parameters import Parameters
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.volume_loads import result_gradients

HALF, SLOPE, LIFT = 4.0, 0.3, 2.0
SQUARE = [-HALF, -HALF, HALF, -HALF, HALF, HALF, -HALF, HALF]
#: Of the trough above or below the level, within the square.
EXACT = 4.0 * HALF**2 * (LIFT + SLOPE * HALF / 2.0)


def estimator(up, seed, count=20_000):
    """A trough with a sharp bottom (up = 1), or its mirror image below the level (-1)."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-HALF - 1.0, HALF + 1.0, (count, 2))
    z = LIFT + SLOPE * np.abs(xy[:, 0] - 0.1) + 0.01 * rng.standard_normal(count)
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
    other = VolumeEstimator(e.parameters)
    other.add_platform(platform())
    other.store._points = e.store.points
    patches = e.store.patches
    none = np.zeros_like(patches.own_residual)
    other.store._patches = dataclasses.replace(patches, own_residual=none)
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
    survey, footing, body = e._main
    gradient = result_gradients(
        survey.tin, footing.base, body.solid, len(survey.points), survey.surface
    )[:, 0]
    patches, total = survey.patches, 0.0
    of = {int(key): j for j, key in enumerate(patches.key)}
    for i in np.flatnonzero(gradient.any(axis=1)):
        j = of[int(survey.points.patch[i])]
        total += float(gradient[i] @ patches.normal[j]) * float(patches.own_residual[j])
    assert v.smoothing_m3 == pytest.approx(-total, rel=1e-9) and abs(total) > 0.01

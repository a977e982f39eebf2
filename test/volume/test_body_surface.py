"""A body is measured on its part of the surface, as it is over the whole."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from cone_pile import estimator_of
from volume_surfaces import cone

from ladar_volume.model.records import Volume
from ladar_volume.volume import estimator as stage
from ladar_volume.volume.field_checks import base_readings, standing_objects
from ladar_volume.volume.measured_body import AROUND_M, BodySurface, body_surface
from ladar_volume.volume.more_data import MoreData

#: Middles, radii and heights of piles, m: a steep one, one that a gap cuts, a flat one, a heap.
PILES = (
    (-22.0, -22.0, 5.0, 4.0),
    (-22.0, 20.0, 5.0, 3.0),
    (0.0, 0.0, 4.0, 2.5),
    (20.0, -20.0, 3.0, 3.5),
    (22.0, 22.0, 4.0, 0.6),
    (2.0, 22.0, 2.0, 1.0),
)


def yard(x, y):
    """Several piles on a slope."""
    heights = [cone(x - a, y - b, r, h) for a, b, r, h in PILES]
    return np.max(heights, axis=0) + 0.01 * x + 2.0


def seen(x, y):
    """All but a hole on a pile and one on the ground."""
    return (np.hypot(x + 22.0, y - 18.0) > 1.6) & (np.hypot(x - 10.0, y) > 2.0)


def same(one: object, two: object) -> None:
    """Numbers differ by rounding alone, all else not at all."""
    if isinstance(one, float):
        assert two == pytest.approx(one, rel=1e-9, abs=1e-12) or math.isnan(one) == math.isnan(two)
    elif isinstance(one, np.ndarray):
        assert one.shape == two.shape and np.allclose(one, two, rtol=1e-9, atol=1e-12)
    elif isinstance(one, dict):
        assert one.keys() == two.keys()
        for name in one:
            same(one[name], two[name])
    elif isinstance(one, tuple):
        assert len(one) == len(two)
        for a, b in zip(one, two, strict=True):
            same(a, b)
    elif dataclasses.is_dataclass(one):
        for field in dataclasses.fields(one):
            same(getattr(one, field.name), getattr(two, field.name))
    else:
        assert one == two


def measured(**volume) -> tuple[tuple[Volume, ...], MoreData]:
    """The bodies of the yard, and where another pass would help the main one."""
    given = {"bodies": 0, "object_height_m": 0.3, "max_edge_m": 6.0} | volume
    estimator = estimator_of(yard, seen, 30.0, **given)
    return estimator.estimate().bodies, estimator.more_data()


@pytest.mark.parametrize("volume", [{}, {"base": "plane", "plane": [2.0, 0.01, 0.0]}])
def test_on_its_part_of_the_surface_a_body_is_what_it_is_over_the_whole(volume, monkeypatch):
    parts = []

    def looked_at(survey, footing, whole, radius_m):
        parts.append(body_surface(survey, footing, whole, radius_m))
        return parts[-1]

    monkeypatch.setattr(stage, "body_surface", looked_at)
    found, more = measured(**volume)
    assert len(found) == len(PILES) and sum(len(body.gaps) for body in found) == 1
    for on in parts:
        assert len(on.vertex) < 0.2 * 240**2
        assert on.part.sum() == pytest.approx(on.whole.sum(), rel=1e-12)
    monkeypatch.setattr(
        stage,
        "body_surface",
        lambda survey, footing, whole, r: BodySurface(whole, survey, whole, None),
    )
    whole, more_of_whole = measured(**volume)
    for one, two in zip(found, whole, strict=True):
        same(two, one)
    same(more_of_whole, more)


def test_the_part_reaches_as_far_as_checks_look():
    assert AROUND_M >= standing_objects.AROUND_M and base_readings.TOE[1] <= 2.0


def test_each_of_many_bodies_is_what_it_is_alone():
    """The sum of what each has is that of all as one body, to rounding."""
    (apart, _), (together, _) = measured(), measured(bodies=1)
    assert len(together) == 1
    (main,) = (b for b in apart if b.centroid_map[:2] == pytest.approx((-22, -22), abs=0.1))
    # another outline has a little of other ground, and so another base
    assert together[0].volume_m3 == pytest.approx(main.volume_m3, rel=5e-3)

"""Several bodies and several ground surfaces of one survey: rows of `volumes` and `grounds`."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.distance import cdist
from volume_surfaces import cone, platform, surface_update

from ladar_volume.ground.polynomial import base_height, design_surface
from ladar_volume.io.message_tables import ground_columns, volume_columns
from ladar_volume.io.results import finite, result_dict
from ladar_volume.io.tables import encode
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Plane
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.base import area_inside, body_of_each
from ladar_volume.volume.estimator import MAX_JOINT, VolumeEstimator, joint_covariance
from ladar_volume.volume.measured_body import Footing
from ladar_volume.volume.outline import labelled_bodies, nearest_bodies

LARGE, SMALL = math.pi * 16.0, math.pi * 4.0 * 2.0 / 3.0


def two_piles(x, y):
    """Radii 4 and 2 m, 3 and 2 m high, and a heap of 0.03 m³, on a slope."""
    return (
        np.maximum(cone(x + 4, y + 4), cone(x - 5, y - 5, 2.0, 2.0))
        + 0.4 * np.maximum(0, 1 - np.hypot(x - 5, y + 5) / 0.5)
        + 0.02 * x
        + 3
    )


def estimate(height, **sections):
    e = VolumeEstimator(Parameters.read({"filter": {"nav_bin_s": 1.0}, **sections}))
    e.add_platform(platform())
    e.add(surface_update(height, spacing=0.25))
    return e.estimate()


def test_two_piles_are_two_rows():
    one = estimate(two_piles)
    both = estimate(two_piles, volume={"bodies": 0})
    assert len(one.bodies) == 1 and one.bodies[0] is one.volume and one.C_bodies_m6 is None
    assert [b.volume_m3 for b in both.bodies] == pytest.approx([LARGE, SMALL], rel=0.01)
    assert both.volume is both.bodies[0] and both.volume.volume_m3 == pytest.approx(
        one.volume.volume_m3, rel=2e-3
    )
    assert both.bodies[0].centroid_map[:2] == pytest.approx((-4, -4), abs=0.03)
    assert both.bodies[1].centroid_map[:2] == pytest.approx((5, 5), abs=0.03)
    for body in both.bodies:
        assert sum(body.budget_m6.values()) == pytest.approx(body.sigma_m3**2, rel=1e-12)
    C = both.C_bodies_m6
    assert (
        np.sqrt(np.diag(C)) == pytest.approx([b.sigma_m3 for b in both.bodies])
        and np.linalg.eigvalsh(C).min() > 0
    )
    table = encode(volume_columns(list(both.bodies)))
    assert table.rows == 2


def test_least_size_and_number_of_bodies():
    assert len(estimate(two_piles, volume={"bodies": 0, "min_body_m3": 0.0}).bodies) == 3
    assert len(estimate(two_piles, volume={"bodies": 0, "min_body_m3": 20.0}).bodies) == 1
    assert len(estimate(two_piles, volume={"bodies": 2, "min_body_m3": 0.0}).bodies) == 2
    # the main body counts whatever its size
    assert len(estimate(two_piles, volume={"bodies": 0, "min_body_m3": 1000.0}).bodies) == 1


def test_an_outline_of_another_kind_is_no_matter_of_bodies():
    axis = np.arange(0.0, 20.5, 0.5)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    one, two = cone(xy[:, 0] - 5, xy[:, 1] - 10, 3.0), cone(xy[:, 0] - 14, xy[:, 1] - 10, 3.0, 2.0)
    tin, base = build_tin(np.c_[xy, np.maximum(one, two)]), design_surface([0.0])
    volume = Parameters.read({"volume": {"bodies": 2, "object_height_m": 0.2}}).volume
    body, count = body_of_each(tin, base, inside := area_inside(tin, base, volume), volume)
    assert count == 2 and np.array_equal(body >= 0, inside > 0)
    footing = Footing(base, inside, body, count, None)
    parts = list(footing.parts())
    assert len(parts) == 2 and np.array_equal(parts[0] + parts[1], inside)
    middle = tin.vertices[tin.triangles, 0].mean(axis=1)
    assert middle[parts[0] > 0].max() < 10.0 < middle[parts[1] > 0].min()
    square = (2.0, 8.0, 18.0, 8.0, 18.0, 12.0, 2.0, 12.0)
    for other in ({"outline": "all"}, {"outline": "polygon", "polygon_m": square}):
        drawn = dataclasses.replace(volume, **other)
        inside = area_inside(tin, base, drawn)
        assert body_of_each(tin, base, inside, drawn) == (None, 1)
        assert Footing(base, inside, None, 1, None).part(0) is inside


def test_a_common_error_correlates_the_bodies_fully():
    sections = {
        "budget": {
            "position_bias_fraction": 1.0,
            "position_white_fraction": 0.0,
            "attitude_bias_fraction": 1.0,
            "attitude_white_fraction": 0.0,
        },
        "volume": {"bodies": 0, "base": "plane", "plane": [3.0, 0.02, 0.0]},
    }
    found = estimate(two_piles, **sections)
    a, b = found.bodies
    assert found.grounds == ()
    # position: an up error lifts the area of each; the bodies' other lines are no more than
    # correlated
    common = math.sqrt(a.budget_m6["position"] * b.budget_m6["position"])
    assert found.C_bodies_m6[0, 1] > 0.99 * common
    assert found.C_bodies_m6[0, 1] <= a.sigma_m3 * b.sigma_m3


def test_joint_covariance_by_polarisation():
    J = np.random.default_rng(0).standard_normal((4, 6))
    C = joint_covariance(
        [float(r @ r) for r in J], lambda a, b: float((J[a] + J[b]) @ (J[a] + J[b]))
    )
    assert pytest.approx(J @ J.T) == C
    assert (
        joint_covariance([1.0], lambda a, b: 0.0) is None
        and joint_covariance([1.0] * (MAX_JOINT + 1), lambda a, b: 0.0) is None
    )


def test_an_outline_is_shared_by_the_nearest_body():
    axis = np.arange(0, 20.5, 0.5)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1).reshape(-1, 2)
    z = np.maximum(
        cone(xy[:, 0] - 5, xy[:, 1] - 10, 3.0), cone(xy[:, 0] - 14, xy[:, 1] - 10, 3.0, 2.0)
    )
    tin = build_tin(np.c_[xy, z])
    label, kept = labelled_bodies(tin, design_surface([0.0]), 0.2, 0)
    assert len(kept) == 2
    found = nearest_bodies(tin, tin.relevant, label, kept)
    assert set(found) == {0, 1}
    # the twin asks each body for its vertex nearest to each centroid
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    far = []
    for body in kept:
        own = tin.vertices[np.unique(tin.triangles[label == body]), :2]
        far.append(cdist(middle, own).min(axis=1))
        assert (found[label == body] == kept.index(body)).all()
    free = ~np.isin(label, kept) & (np.abs(far[0] - far[1]) > 1e-9)
    assert np.array_equal(found[free], np.argmin(far, axis=0)[free])
    half = nearest_bodies(tin, middle[:, 1] < 10.0, label, kept)
    assert np.array_equal(half, np.where(middle[:, 1] < 10.0, found, -1))
    one = nearest_bodies(tin, tin.relevant, label, kept[:1])
    assert not one.any()


def test_triangles_as_near_to_two_bodies_go_to_the_larger_in_any_order():
    axis = np.r_[0.0:28.0:3.0, 29.0:60.0:3.0]  # 4 m to either body from the middles at 25 m
    xy = np.stack(np.meshgrid(axis, np.r_[0.0:61.0:3.0], indexing="ij"), -1).reshape(-1, 2)
    within = (xy[:, 1] >= 9.0) & (xy[:, 1] <= 51.0)
    z = np.where(within & (xy[:, 0] >= 3.0) & (xy[:, 0] <= 21.0), 2.0, 0.0)
    z += np.where(within & (xy[:, 0] >= 29.0) & (xy[:, 0] <= 47.0), 1.0, 0.0)
    rng = np.random.default_rng(0)
    for order in (np.arange(len(xy)), *(rng.permutation(len(xy)) for _ in range(4))):
        tin = build_tin(np.c_[xy, z][order])
        label, kept = labelled_bodies(tin, design_surface([0.0]), 0.2, 0)
        own = nearest_bodies(tin, tin.relevant, label, kept)
        middle = tin.vertices[tin.triangles, :2].mean(axis=1)
        between = (np.abs(middle[:, 1] - 30.0) < 20.0) & (np.abs(middle[:, 0] - 25.0) < 1e-9)
        assert np.count_nonzero(between) > 5 and not own[between].any()
        assert (own[middle[:, 0] > 26.0] == 1).all()
        assert len(kept) == 2


def terrace_with_pile(x, y):
    return np.where(x < 3.0, 0.0, 1.5) + cone(x + 4, y, 3.0, 2.0) + 5.0


def test_terraces_are_listed_and_the_volume_stands_on_the_main_one():
    found = estimate(
        terrace_with_pile,
        ground={"surfaces": 5},
        volume={"outline": "polygon", "polygon_m": [-8, -4, 0, -4, 0, 4, -8, 4]},
    )
    assert len(found.grounds) == 2 and found.grounds[0] is found.base
    low, high = found.grounds
    assert base_height(low, np.array([[0.0, 0.0]])) == pytest.approx([5.0], abs=1e-3)
    assert base_height(high, np.array([[8.0, 0.0]])) == pytest.approx([6.5], abs=1e-3)
    assert found.volume.volume_m3 == pytest.approx(math.pi * 6.0, rel=0.01)
    alone = estimate(
        terrace_with_pile, volume={"outline": "polygon", "polygon_m": [-8, -4, 0, -4, 0, 4, -8, 4]}
    )
    assert alone.grounds == (alone.base,) and alone.volume.volume_m3 == found.volume.volume_m3
    values = finite(result_dict(found, Parameters(), Losses(), None, {}, {}))
    assert (
        [g["degree"] for g in values["grounds"]] == [1, 1]
        and len(values["bodies"]) == 1
        and values["C_bodies_m6"] is None
    )


def test_a_pit_in_a_polygon_is_no_ground():
    def pit(x, y):
        return np.where((np.abs(x) < 7) & (np.abs(y) < 7), -2.0, 0.0)

    found = estimate(pit, volume={"outline": "polygon", "polygon_m": [-8, -8, 8, -8, 8, 8, -8, 8]})
    assert found.volume.volume_m3 == pytest.approx(-2.0 * 14.0**2, rel=0.01)


def test_the_table_of_grounds():
    C = np.arange(9.0).reshape(3, 3)
    plane = Plane(np.array([1.0, 2.0]), np.array([5.0, 0.3, 0.4]), C + C.T, np.arange(7), 0.01)
    cubic = design_surface(list(np.arange(1.0, 11.0)), (3.0, 4.0))
    columns = ground_columns([plane, cubic])
    assert columns["beta"].tolist() == [
        [5.0, 0.3, 0.4] + [0.0] * 7,
        list(range(1, 11)),
    ] and columns["covariance"].shape == (2, 55)
    full = np.zeros((10, 10))
    full[np.triu_indices(10)] = columns["covariance"][0]
    assert np.array_equal(full[:3, :3], np.triu(C + C.T)) and not full[3:].any()
    assert (
        columns["degree"].tolist() == [1, 3]
        and columns["id"].tolist() == [0, 1]
        and columns["support"].tolist() == [7, 0]
    )
    assert columns["tilt"] == pytest.approx(
        [math.atan(0.5), math.atan(math.hypot(2, 3))]
    ) and columns["z"].tolist() == [5.0, 1.0]
    assert ground_columns([plane])["covariance"].shape == (1, 6)
    assert encode(columns).rows == 2


def test_passes_that_refute_the_budget_enlarge_what_the_bodies_share(monkeypatch):
    piles = {"volume": {"bodies": 0, "budget_check": "scale"}}
    plain = estimate(two_piles, **piles).C_bodies_m6
    monkeypatch.setattr("ladar_volume.volume.estimator.variance_ratio", lambda *found: 4.0)
    assert estimate(two_piles, **piles).C_bodies_m6[0, 1] == pytest.approx(4.0 * plain[0, 1])
    assert abs(plain[0, 1]) > 0.0

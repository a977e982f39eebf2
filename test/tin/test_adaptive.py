"""Adaptive insertion: against choosing by brute force, closed forms, invariances, and input that
must be refused.
"""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.model.choices import CRITERIA
from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.adaptive import adaptive_tin
from ladar_volume.tin.delaunay import delaunay, find_fault
from ladar_volume.tin.full_tin import footprint_areas


def hills(n, seed=0, noise=0.05):
    rng = np.random.default_rng(seed)
    xy = rng.random((n, 2)) * [40.0, 25.0]
    return np.column_stack(
        [xy, 3.0 * np.sin(xy[:, 0] / 4.0) * np.cos(xy[:, 1] / 5.0) + rng.normal(0.0, noise, n)]
    )


def surface_at(vertices, triangles, xy):
    """Heights and areas by testing every triangle, with the largest smallest weight."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = footprint_areas(vertices, triangles)
    heights, areas = np.empty(len(xy)), np.empty(len(xy))
    for i, p in enumerate(xy):
        d = np.stack([v[:, :2] - p for v in (a, b, c)])
        w = np.stack(
            [
                d[(k + 1) % 3, :, 0] * d[(k + 2) % 3, :, 1]
                - d[(k + 1) % 3, :, 1] * d[(k + 2) % 3, :, 0]
                for k in range(3)
            ]
        )
        t = int(np.argmax(w.min(axis=0) / (2.0 * area)))
        heights[i] = (w[:, t] * [a[t, 2], b[t, 2], c[t, 2]]).sum() / w[:, t].sum()
        areas[i] = area[t]
    return heights, areas


def by_brute_force(points, out, steps, criterion, sigma):
    """The next ``steps`` choices after the initial vertices, each from a triangulation made
    anew.
    """
    chosen = list(out.insertion_order[: out.initial])
    corners = out.tin.vertices[out.artificial]
    for _ in range(steps):
        vertices = np.concatenate([points[chosen], corners])
        heights, areas = surface_at(vertices, delaunay(vertices[:, :2])[0], points[:, :2])
        size = np.abs(points[:, 2] - heights)
        value = {"residual": size, "residual-area": size * areas, "residual-sigma": size / sigma}[
            criterion
        ]
        value[chosen] = -1.0
        yield int(np.argmax(value)), float(value.max())
        chosen.append(int(np.argmax(value)))


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("seed", [1, 2])
def test_every_choice_is_the_one_of_brute_force(criterion, seed):
    points = hills(150, seed)
    sigma = np.random.default_rng(seed).uniform(0.5, 2.0, 150)
    out = adaptive_tin(points, vertices=90, criterion=criterion, sigma_m=sigma, bins_per_row=3)
    assert len(out.insertion_order) == 90 and out.initial == 6
    for k, (index, value) in enumerate(by_brute_force(points, out, 84, criterion, sigma)):
        assert out.insertion_order[6 + k] == index
        assert out.score[6 + k] == pytest.approx(value, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_the_result_is_delaunay_and_its_residuals_are_those_of_its_surface(criterion):
    points = hills(1000, 3)
    out = adaptive_tin(points, criterion=criterion, sigma_m=np.ones(1000))
    tin = out.tin
    assert find_fault(tin.vertices[:, :2], tin.triangles, tin.neighbours) == ""
    assert (
        len(out.insertion_order) == 333
        and np.array_equal(np.sort(out.insertion_order), tin.source[:333])
        and len(tin.vertices) == 337
    )
    assert (
        np.array_equal(tin.vertices[:333], points[tin.source[:333]])
        and (tin.source[333:] == -1).all()
    )
    assert np.array_equal(
        tin.relevant, (tin.triangles < 333).all(axis=1)
    ) and out.artificial.tolist() == [333, 334, 335, 336]
    heights, _ = surface_at(tin.vertices, tin.triangles, points[:, :2])
    np.testing.assert_allclose(out.residual, points[:, 2] - heights, rtol=0, atol=1e-12)
    assert (out.residual[out.insertion_order] == 0.0).all()
    assert (out.triangle >= 0).sum() == 1000


def test_a_full_triangulation_has_every_point_and_no_residual():
    points = hills(500, 4)
    out = adaptive_tin(points, ratio=1.0)
    relevant = np.unique(out.tin.triangles[out.tin.relevant])
    assert (
        len(out.insertion_order) == out.initial == 500
        and (out.residual == 0.0).all()
        and out.tin.relevant[out.triangle].sum() == len(relevant)
    )
    corners = [
        [out.window[0], out.window[1]],
        [out.window[2], out.window[1]],
        [out.window[2], out.window[3]],
        [out.window[0], out.window[3]],
    ]
    triangles, _ = delaunay(np.concatenate([points[:, :2], corners]))
    assert {tuple(sorted(t)) for t in triangles.tolist()} == {
        tuple(sorted(t)) for t in out.tin.triangles.tolist()
    }


def test_the_tolerance_ends_the_insertion_and_holds():
    points = hills(2000, 5, noise=0.0)
    for criterion in CRITERIA:
        out = adaptive_tin(points, tolerance=0.25, criterion=criterion, sigma_m=np.full(2000, 0.5))
        limit = 0.125 if criterion == "residual-sigma" else 0.25
        assert np.abs(out.residual).max() <= limit and 50 < len(out.insertion_order) < 1500
    assert len(adaptive_tin(points, tolerance=0.01, vertices=200).insertion_order) == 200
    assert len(adaptive_tin(points, tolerance=np.inf, bins_per_row=2).insertion_order) == 2


def test_a_plane_needs_no_more_than_its_corners():
    x, y = np.meshgrid(np.arange(12.0), np.arange(9.0))
    points = np.column_stack([x.ravel(), y.ravel(), (2.0 * x - y).ravel()])
    out = adaptive_tin(points, tolerance=0.0, bins_per_row=1)
    # a grid's corners are data: nothing is artificial, everything relevant
    assert (
        len(out.artificial) == 0
        and out.tin.relevant.all()
        and len(out.insertion_order) == 5
        and (out.residual == 0.0).all()
    )
    assert footprint_areas(out.tin.vertices, out.tin.triangles).sum() == 88.0
    spike = points.copy()
    spike[37, 2] += 1.0
    assert adaptive_tin(spike, vertices=6, bins_per_row=1).insertion_order[5] == 37


@pytest.mark.parametrize("criterion", CRITERIA)
def test_ties_go_to_the_first_point_whatever_the_grid(criterion):
    x, y = np.meshgrid(np.arange(9.0), np.arange(9.0))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(81)])
    out = adaptive_tin(
        points, vertices=30, criterion=criterion, sigma_m=np.ones(81), bins_per_row=1
    )
    assert (
        out.insertion_order[out.initial :].tolist()
        == [k for k in range(81) if k not in out.insertion_order[: out.initial]][: 30 - out.initial]
    )
    assert (out.score[out.initial :] == 0.0).all()
    assert find_fault(out.tin.vertices[:, :2], out.tin.triangles, out.tin.neighbours) == ""


def test_binning_takes_the_point_nearest_each_centre_column_by_column():
    points = np.array(
        [
            [0.0, 0, 1],
            [4, 0, 2],
            [4, 4, 3],
            [0, 4, 4],
            [1.1, 1, 5],
            [1.0, 1.0, 6],
            [1, 3.2, 7],
            [3, 0.7, 8],
            [3.4, 3, 9],
            [3.2, 3.3, 9],
        ]
    )
    out = adaptive_tin(points, vertices=8, bins_per_row=2)
    assert (
        sorted(out.insertion_order[:4].tolist()) == [0, 1, 2, 3]
        and out.insertion_order[4:].tolist() == [5, 6, 7, 9]
        and out.initial == 8
    )
    with pytest.raises(SurfaceError) as caught:
        adaptive_tin(points, vertices=7, bins_per_row=2)
    assert caught.value.reason == "surface_bins"
    assert len(adaptive_tin(points, vertices=2).insertion_order) == 4  # corners are always vertices


def test_cropping_to_a_window_equals_cropping_before():
    points = hills(800, 6)
    window = (8.0, 5.0, 30.0, 20.0)
    out = adaptive_tin(points, window=window)
    keep = (points[:, 0] >= 8) & (points[:, 0] <= 30) & (points[:, 1] >= 5) & (points[:, 1] <= 20)
    assert (
        out.off_map_count == (~keep).sum()
        and np.isnan(out.residual[~keep]).all()
        and (out.triangle[~keep] == -1).all()
    )
    before = adaptive_tin(points[keep], window=window)
    assert np.array_equal(
        out.insertion_order, np.flatnonzero(keep)[before.insertion_order]
    ) and np.array_equal(out.tin.triangles, before.tin.triangles)
    assert np.array_equal(out.residual[keep], before.residual) and len(
        out.insertion_order
    ) == round(keep.sum() / 3)
    assert out.tin.vertices[:, :2].min(axis=0).tolist() == [8.0, 5.0] and out.window == window


def test_corner_heights():
    points = hills(300, 7)
    out = adaptive_tin(points, corner_height_m=-7.5)
    assert (out.tin.vertices[out.artificial, 2] == -7.5).all()
    out = adaptive_tin(points)
    for v in out.tin.vertices[out.artificial]:
        assert v[2] == points[np.argmin(((points[:, :2] - v[:2]) ** 2).sum(axis=1)), 2]


@pytest.mark.parametrize("tolerance", [0.0, 0.4])
def test_points_over_one_footprint_count_in_the_fit_but_are_one_vertex(tolerance):
    points = hills(200, 8)
    points = np.concatenate([points, points[:50] + np.array([0.0, 0.0, 9.0]), points[:30]])
    out = adaptive_tin(points, ratio=1.0, duplicate_tolerance_m=tolerance)
    kept = np.flatnonzero(out.same == np.arange(280))
    assert np.array_equal(np.sort(out.insertion_order), kept) and out.tin.duplicates == 280 - len(
        kept
    )
    assert (len(kept) == 200) == (tolerance == 0.0) and out.same[200] == out.same[0]
    if tolerance == 0.0:
        np.testing.assert_allclose(out.residual[200:250], 9.0, rtol=0, atol=1e-12)
        assert (out.triangle >= 0).sum() == 280
    else:
        d = np.linalg.norm(points[kept, None, :2] - points[None, kept, :2], axis=2)
        assert d[~np.eye(len(kept), dtype=bool)].min() > 0.4
        assert np.linalg.norm(points[:, :2] - points[out.same, :2], axis=1).max() <= 0.4


def test_input_order_and_powers_of_two_change_nothing():
    points = hills(600, 9)
    order = np.random.default_rng(1).permutation(600)
    a, b, c = adaptive_tin(points), adaptive_tin(points[order]), adaptive_tin(points * 4.0)
    assert np.array_equal(a.insertion_order, order[b.insertion_order]) and np.array_equal(
        a.insertion_order, c.insertion_order
    )
    assert np.array_equal(a.residual[order], b.residual)


@pytest.mark.parametrize("offset", [0.0, 5.0e6, 2.0**40])
def test_map_coordinates(offset):
    points = hills(700, 10)
    points[:, :2] = np.round(points[:, :2] * 2**12) / 2**12  # exact at every offset
    out = adaptive_tin(points + np.array([offset, -offset, 0.0]))
    assert np.array_equal(out.insertion_order, adaptive_tin(points).insertion_order)
    assert find_fault(out.tin.vertices[:, :2], out.tin.triangles, out.tin.neighbours) == ""


@pytest.mark.parametrize("count", [1, 2, 3])
def test_one_to_three_points_on_a_given_map(count):
    points = np.array([[1.0, 1.0, 5.0], [2.0, 1.0, 6.0], [1.5, 2.0, 9.0]])[:count]
    out = adaptive_tin(points, window=(0.0, 0.0, 3.0, 3.0), ratio=1.0)
    assert len(out.insertion_order) == count and out.tin.relevant.sum() == (count == 3)
    assert find_fault(out.tin.vertices[:, :2], out.tin.triangles, out.tin.neighbours) == ""
    if count < 3:
        window = (0.0, 0.0, 3.0, 3.0)
        one = adaptive_tin(points, window=window, vertices=1, duplicate_tolerance_m=2.0)
        assert not one.tin.relevant[one.triangle].any()


def test_hostile_clouds_stay_valid():
    rng = np.random.default_rng(11)
    t = np.arange(60.0)
    a = rng.integers(0, 24, 300) * (np.pi / 12)
    clouds = [
        np.column_stack([np.cos(a), np.sin(a), rng.normal(size=300)]),
        np.column_stack([t * 0.1, t * 0.3, rng.normal(size=60)]),
        np.column_stack([rng.random((200, 2)) * [1.0, 1e-13], rng.normal(size=200)]),
        np.column_stack([rng.random((200, 2)) * [1e-7, 1.0], rng.normal(size=200)]),
        np.column_stack([rng.integers(0, 15, (400, 2)) * 0.1 + 1000.1, rng.normal(size=400)]),
        np.concatenate(
            [
                np.column_stack([rng.random((200, 2)) * 1e-6, rng.normal(size=200)]),
                [[1e6, 1e6, 0.0], [-1e6, 3e5, 1.0]],
            ]
        ),
    ]
    for points in clouds:
        for ratio in (0.3, 1.0):
            out = adaptive_tin(points, ratio=ratio)
            assert find_fault(out.tin.vertices[:, :2], out.tin.triangles, out.tin.neighbours) == ""
            assert np.isfinite(out.residual).all() and (out.triangle >= 0).all()
            low, high = points[:, 2].min(), points[:, 2].max()
            assert np.abs(out.residual).max() <= high - low
    assert out.exact_predicates >= 0 and adaptive_tin(clouds[4]).exact_predicates > 0


@pytest.mark.parametrize(
    "points,options,reason",
    [
        (np.zeros((0, 3)), {}, "surface_too_few_points"),
        (np.zeros((1, 3)), {}, "surface_window"),
        (np.array([[0.0, 0, 0], [5, 0, 1], [9, 0, 2]]), {}, "surface_window"),
        (hills(20), {"window": (50.0, 0.0, 60.0, 1.0)}, "surface_too_few_points"),
        (hills(20), {"window": (1.0, 0.0, np.nan, 1.0)}, "surface_window"),
        (hills(20)[:, :2], {}, "surface_shape"),
        (np.where(np.eye(5, 3) > 0, np.nan, 1.0), {}, "surface_not_finite"),
        (hills(20), {"criterion": "best"}, "surface_criterion"),
        (hills(20), {"criterion": "residual-sigma"}, "surface_sigma"),
        (hills(20), {"criterion": "residual-sigma", "sigma_m": np.zeros(20)}, "surface_sigma"),
        (hills(20), {"vertices": 5, "ratio": 0.5}, "surface_vertices"),
        (hills(20), {"vertices": 0}, "surface_vertices"),
        (hills(20), {"ratio": 0.0}, "surface_vertices"),
        (hills(20), {"ratio": 1.1}, "surface_vertices"),
        (hills(20), {"tolerance": -1.0}, "surface_tolerance"),
        (hills(20), {"tolerance": np.nan}, "surface_tolerance"),
        (hills(20), {"duplicate_tolerance_m": -1.0}, "surface_tolerance"),
        (hills(20), {"bins_per_row": 0}, "surface_bins"),
    ],
)
def test_refusals(points, options, reason):
    with pytest.raises(SurfaceError) as caught:
        adaptive_tin(points, **options)
    assert caught.value.reason == reason

"""Two surfaces and a pole: exact pits, overhangs, the cost of a missing boundary ring, gradient,
Monte Carlo, regions, refusals.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.pits import PITS, pit, rim, without_ring
from ladar_volume.change.sight_ring import (
    GROUP,
    cast,
    cast_kernel,
    densify,
    ring_over,
    ring_through,
    target,
)
from ladar_volume.change.spherical_tin import build_spherical
from ladar_volume.change.two_surfaces import (
    cone_volume,
    published_difference,
    select_regions,
    two_surface_budget,
    two_surfaces,
)
from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.errors import SurfaceError, VolumeError
from ladar_volume.registration.sphere_adjustment import register
from ladar_volume.registration.transform import Transform


@pytest.fixture(scope="module", params=list(PITS))
def case(request):
    opening, floor, depth, scanner = PITS[request.param]
    before, after, truth = pit(opening, floor, depth, 0.2)
    return before, after, truth, opening, np.array(scanner)


def difference(case, h=0.2, **kwargs):
    before, after, _, opening, scanner = case
    return two_surfaces(
        before, after, ring_over(rim(opening, 0.4), 3.0, h), scanner, scanner, **kwargs
    )


def test_four_pits_two_of_them_overhanging(case):
    truth = case[2]
    d = difference(case)
    assert d.removed_m3 == pytest.approx(truth, rel=2e-5) and d.pole_spread_m3 < 1e-9 * truth
    assert np.abs(d.gap_m).max() < 1e-9 and d.bridged_m2 == (0.0, 0.0)
    # the other way round it is added
    before, after, _, opening, scanner = case
    back = two_surfaces(
        after,
        before,
        ring_over(rim(opening, 0.4), 3.0, 0.2),
        scanner,
        scanner,
        pole_map=np.array([50.0, -20, 9]),
    )
    assert back.removed_m3 == pytest.approx(-d.removed_m3, rel=1e-9)


def test_each_scan_from_its_own_scanner_and_the_ring_either_way_round(case):
    before, after, truth, opening, scanner = case
    ring = ring_over(rim(opening, 0.4), 3.0, 0.2)
    for r in (ring, ring.reversed()):
        d = two_surfaces(before, after, r, scanner + np.array([-0.7, 0.3, 1.0]), scanner)
        assert d.removed_m3 == pytest.approx(truth, rel=5e-5)


@pytest.mark.parametrize("lean", [0.0, 0.3])
def test_a_pocket_in_a_leaning_wall_seen_from_in_front(lean):
    """The rock face hangs over the scanner by ``lean``, rad; heights over a plan do not exist
    here.
    """
    opening, floor, depth, scanner = PITS["frustum"]
    before, after, truth = pit(opening, floor, depth, 0.2)
    R, shift = exp_so3(np.array([0.0, np.pi / 2 + lean, 0.0])), np.array([1000.0, 2000, 100])
    eye = R @ np.array(scanner) + shift
    corners = np.concatenate([rim(opening, 0.4), np.zeros((4, 1))], axis=1) @ R.T + shift
    d = two_surfaces(
        before @ R.T + shift, after @ R.T + shift, ring_through(corners, eye, 0.2), eye, eye
    )
    assert d.removed_m3 == pytest.approx(truth, rel=2e-5) and d.pole_spread_m3 < 1e-8 * truth


def test_what_a_missing_boundary_ring_costs_and_that_the_common_ring_costs_nothing(case):
    before, after, truth, opening, scanner = case
    whole, part = (
        build_spherical(after, scanner),
        build_spherical(without_ring(after, opening), scanner),
    )
    a = build_spherical(before, scanner)
    assert published_difference(a, whole, scanner) == pytest.approx(truth, rel=5e-5)
    cost = published_difference(a, part, scanner) / truth - 1
    assert -0.14 < cost < -0.02
    # and then the pole matters: three metres higher it is more
    assert published_difference(a, part, scanner + np.array([0.0, 0, 3])) / truth - 1 < 2 * cost
    d = two_surfaces(
        before,
        without_ring(after, opening),
        ring_over(rim(opening, 0.4), 3.0, 0.2),
        scanner,
        scanner,
    )
    assert d.removed_m3 == pytest.approx(truth, rel=5e-5)


def test_a_cone_has_its_closed_form():
    before, *_ = pit((0, 4, 0, 2), (0, 4, 0, 2), 2.0, 0.5)
    s = build_spherical(before, np.array([2.0, 1, 1.5]))
    assert cone_volume(s, np.array([2.0, 1, 1.5])) == pytest.approx(6 * 4 * 1.5 / 3, rel=1e-9)


def noisy(case, sigma, rng):
    before, after, *_ = case
    return before + sigma * rng.standard_normal(before.shape), after + sigma * rng.standard_normal(
        after.shape
    )


def test_gradient_against_differences(case):
    _, _, _, opening, scanner = case
    rng = np.random.default_rng(1)
    a, b = noisy(case, 0.01, rng)
    ring = ring_over(rim(opening, 0.43), 3.0, 0.2)
    d = two_surfaces(a, b, ring, scanner, scanner)
    for points, g, which in ((a, d.gradient_a, 0), (b, d.gradient_b, 1)):
        edge = np.argsort(np.abs(points[:, 0] - opening[0] + 0.43) + 9 * (points[:, 2] < -0.1))[
            :2
        ]  # some depend on the ring
        for i in [*edge, *rng.choice(np.flatnonzero(np.abs(g).sum(axis=1) > 0), 2)]:
            u = rng.standard_normal(3)
            volume = []
            for e in (1e-7, -1e-7):
                moved = points.copy()
                moved[i] += e * u
                pair = (moved, b) if which == 0 else (a, moved)
                volume.append(two_surfaces(*pair, ring, scanner, scanner).removed_m3)
            assert (volume[0] - volume[1]) / 2e-7 == pytest.approx(g[i] @ u, rel=1e-3, abs=2e-6)


def test_shifting_both_scans_changes_nothing_but_where_the_ring_is(case):
    d = difference(case)
    assert d.gradient_a.sum(axis=0) + d.gradient_b.sum(axis=0) == pytest.approx(0, abs=1e-6)
    # B alone: lowering it by 1 m adds the area within the ring, so the budget sees a registration's
    # height error
    area = (rim(case[3], 0.4)[2] - rim(case[3], 0.4)[0]).prod()
    assert d.gradient_b[:, 2].sum() == pytest.approx(-area, rel=1e-6)


@pytest.mark.parametrize("name", ["frustum", "overhang"])
def test_noise_budget_by_monte_carlo(name):
    opening, floor, depth, scanner = PITS[name]
    case = (*pit(opening, floor, depth, 0.4), opening, np.array(scanner))
    rng, sigma = np.random.default_rng(2), 0.01
    ring = ring_over(rim(opening, 0.43), 3.0, 0.4)
    volumes, predicted = [], []
    for _ in range(70):
        a, b = noisy(case, sigma, rng)
        d = two_surfaces(a, b, ring, case[4], case[4])
        volumes.append(d.removed_m3)
        predicted.append(sum(two_surface_budget(d, sigma, np.full(len(b), sigma)).values()))
    assert np.std(volumes) / np.sqrt(np.mean(predicted)) == pytest.approx(1.0, abs=0.2)
    assert abs(np.mean(volumes) / case[2] - 1) < 0.002


@pytest.mark.parametrize("name", ["frustum", "slit"])
def test_registration_enters_with_its_covariance(name):
    opening, floor, depth, scanner = PITS[name]
    before, after, _ = pit(opening, floor, depth, 0.3)
    rng = np.random.default_rng(3)
    spheres = np.array([[-2.0, -2, 0.5], [6, -2, 1.5], [6, 6, 0.4], [-2, 6, 1.0]])
    C = np.repeat(0.01**2 * np.eye(3)[None], 4, axis=0)
    T = register(spheres, spheres, C, C, levelled=True).transform
    scanner, ring = np.array(scanner), ring_over(rim(opening, 0.43), 3.0, 0.3)
    d = two_surfaces(before, after, ring, scanner, scanner)
    budget = two_surface_budget(d, 0.01, 0.01, T, after)
    free = [2, 3, 4, 5]
    L, volumes = np.linalg.cholesky(T.C[np.ix_(free, free)]), []
    for _ in range(50):
        x = np.zeros(7)
        x[free] = L @ rng.standard_normal(4)
        volumes.append(
            two_surfaces(before, T.perturb(x).apply(after), ring, scanner, scanner).removed_m3
        )
    assert np.std(volumes) / np.sqrt(budget["registration_b"]) == pytest.approx(1.0, abs=0.2)
    assert budget["registration_b"] > 10 * budget["noise_b"]  # what is common does not average out
    with pytest.raises(VolumeError):
        two_surface_budget(d, 0.01, 0.01, T)
    assert "registration_a" in two_surface_budget(
        d,
        0.01,
        0.01,
        transform_a=Transform(np.eye(3), np.zeros(3), np.zeros(3), 1.0, T.C),
        source_a=before,
    )


def test_wide_triangles_are_counted():
    opening, floor, depth, scanner = PITS["frustum"]
    scanner = np.array(scanner) + np.array(
        [0.0, 0, 1.5]
    )  # from high up no triangle of the ground is long
    before, after, truth = pit(opening, floor, depth, 0.2)
    x = 0.5 * (opening[0] + opening[1])
    hole = (np.abs(before[:, 0] - x) < 0.5) & (np.abs(before[:, 1] - 2.0) < 0.5)
    d = two_surfaces(
        before[~hole],
        after,
        ring_over(rim(opening, 0.4), 3.0, 0.2),
        scanner,
        scanner,
        max_edge_m=0.7,
    )
    assert d.removed_m3 == pytest.approx(truth, rel=5e-5) and d.bridged_m2[0] > 0.8


def test_regions():
    grid = np.stack(np.meshgrid(np.arange(-10, 11.0), np.arange(-10, 11.0)), axis=-1).reshape(-1, 2)
    a, b = (np.concatenate([grid, np.full((len(grid), 1), z)], axis=1) for z in (0.0, -5.0))
    in_a, in_b = select_regions(a, b, np.array([[-2.5, -2.5], [2.5, -2.5], [-2.5, 2.5]]), 1.0)
    assert in_a[(grid == [0, -1]).all(axis=1)].all() and in_a[(grid == [-3, -3]).all(axis=1)].all()
    assert not in_a[(grid == [2, 2]).all(axis=1)].any() and in_a.sum() < in_b.sum() == 49
    for polygon, margin in (
        (np.zeros((0, 2)), 1.0),
        (np.full((3, 2), np.nan), 1.0),
        (grid[:3], -1.0),
        (grid[:3] + 100, 1.0),
    ):
        with pytest.raises(VolumeError):
            select_regions(a, b, polygon, margin)
    with pytest.raises(VolumeError):
        select_regions(a, b + 100, np.array([[-2.5, -2.5], [2.5, -2.5], [-2.5, 2.5]]), 0.0)


def test_rays_meet_the_first_of_all_triangles():
    surface = target(
        build_spherical(pit((0, 2, 0, 2), (0, 2, 0, 2), 1.0, 0.5)[1], np.array([1.0, 1, 1])).tin
    )
    ring = ring_over(rim((0, 2, 0, 2), 0.3), 2.0, 0.7)
    hits = cast(ring, surface, "A")
    assert hits.point[:, 2] == pytest.approx(0, abs=1e-12) and hits.weight.sum(
        axis=1
    ) == pytest.approx(1)
    a, b, c = np.swapaxes(surface.corners, 0, 1)
    for i in range(len(ring)):
        # origin + s direction = a + u (b − a) + v (c − a), for every triangle
        sides = np.stack([b - a, c - a, np.broadcast_to(-ring.direction[i], a.shape)], axis=2)
        good = np.abs(np.linalg.det(sides)) > 1e-12
        u, v, s = np.linalg.solve(sides[good], (ring.origin[i] - a[good])[..., None])[..., 0].T
        met = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (s > 0.0)
        assert hits.distance[i] == pytest.approx(s[met].min(), rel=1e-9)
        first = np.flatnonzero(good)[met][np.isclose(s[met], s[met].min(), rtol=1e-9)]
        assert hits.corner[i].tolist() in surface.triangles[first].tolist()


def test_rays_among_groups_that_are_mostly_passed_over():
    """Groups of small triangles, each within its ball: what all triangles together give."""
    rng, many = np.random.default_rng(8), 6
    centre = np.repeat(rng.uniform(-3.0, 3.0, (many, 3)), GROUP, axis=0)
    corners = centre[:, None] + rng.uniform(-0.6, 0.6, (len(centre), 3, 3))
    aim = corners[rng.integers(0, len(corners), 60)].mean(axis=1)
    origin = rng.uniform(-6.0, 6.0, (60, 3))
    direction = (aim - origin) / np.linalg.norm(aim - origin, axis=1)[:, None]
    middle = centre[::GROUP]
    size = np.linalg.norm(corners.reshape(many, -1, 3) - middle[:, None], axis=2).max(axis=1)
    found, weight, reach = np.full(60, -1), np.zeros((60, 3)), np.zeros(60)
    cast_kernel(corners, np.c_[middle, size**2], origin, direction, found, weight, reach)
    a, b, c = np.swapaxes(corners, 0, 1)
    for i in range(60):
        sides = np.stack([b - a, c - a, np.broadcast_to(-direction[i], a.shape)], axis=2)
        u, v, s = np.linalg.solve(sides, (origin[i] - a)[..., None])[..., 0].T
        s[(u < 0.0) | (v < 0.0) | (u + v > 1.0) | (s <= 0.0)] = np.inf
        first = int(np.argmin(s))
        assert found[i] == first and reach[i] == pytest.approx(s[first], rel=1e-9)
        assert weight[i] == pytest.approx([1 - u[first] - v[first], u[first], v[first]], abs=1e-9)


def test_a_ring_on_planes_through_the_points_around():
    """Exact on plane ground; its gradient is that of the planes; and noise that folds the surface
    does not tear it.
    """
    opening, floor, depth, scanner = PITS["frustum"]
    before, after, truth = pit(opening, floor, depth, 0.1)
    eye, ring = np.array(scanner), ring_over(rim(opening, 0.45), 3.0, 0.1)
    d = two_surfaces(before, after, ring, eye, eye, ring_radius_m=0.3)
    assert d.removed_m3 == pytest.approx(truth, rel=1e-9) and np.abs(d.gap_m).max() < 1e-9
    assert d.gradient_a.sum(axis=0) + d.gradient_b.sum(axis=0) == pytest.approx(0, abs=1e-6)
    rng = np.random.default_rng(6)
    a, b = (p + 1e-4 * rng.standard_normal(p.shape) for p in (before, after))
    d = two_surfaces(a, b, ring, eye, eye, ring_radius_m=0.3)
    near = np.flatnonzero((np.abs(a[:, 0] - opening[0] + 0.45) < 0.2) & (np.abs(a[:, 1] - 2) < 1.5))
    for i in rng.choice(near, 4):
        u = np.array([0.0, 0, 1e-6])
        volume = []
        for sign in (1, -1):
            moved = a.copy()
            moved[i] += sign * u
            volume.append(two_surfaces(moved, b, ring, eye, eye, ring_radius_m=0.3).removed_m3)
        assert (volume[0] - volume[1]) / 2e-6 == pytest.approx(
            d.gradient_a[i, 2], rel=0.02, abs=2e-5
        )
    a, b = (p + 0.03 * rng.standard_normal(p.shape) for p in (before, after))
    d = two_surfaces(a, b, ring, eye, eye, ring_radius_m=0.24)
    assert d.removed_m3 == pytest.approx(truth, rel=0.01) and d.pole_spread_m3 < 1e-9 * truth


def test_too_few_points_around_leave_the_ring_on_the_triangles():
    opening, floor, depth, scanner = PITS["box"]
    surface = target(build_spherical(pit(opening, floor, depth, 0.4)[1], np.array(scanner)).tin)
    ring = ring_over(rim(opening, 0.4), 3.0, 0.5)
    exact, fitted = cast(ring, surface, "B"), cast(ring, surface, "B", 0.05)
    assert fitted.point == pytest.approx(exact.point) and fitted.weight.sum(
        axis=1
    ) == pytest.approx(1)


def reason(*args, **kwargs):
    with pytest.raises((VolumeError, SurfaceError)) as caught:
        two_surfaces(*args, **kwargs)
    return caught.value.reason


def test_refusals():
    opening, floor, depth, scanner = PITS["box"]
    a, b, _ = pit(opening, floor, depth, 0.4)
    s = np.array(scanner)
    ring = ring_over(rim(opening, 0.4), 3.0, 0.3)
    assert reason(a, b, ring_over(rim(opening, 5.0), 3.0, 0.3), s, s) == "ring_off_surface"
    eight = np.array([[-0.5, -0.5], [4.5, 2.5], [4.5, -0.5], [-0.5, 2.5]])
    assert reason(a, b, ring_over(eight, 3.0, 0.3), s, s) in (
        "ring_touches",
        "ring_lost",
        "ring_sides",
    )
    assert reason(a, b, ring, s, s * [1, 1, -1]) in ("ring_sides", "ring_touches", "ring_lost")
    assert reason(a[:2], b, ring, s, s) == "surface_too_few_points"
    assert reason(a * np.nan, b, ring, s, s) == "surface_not_finite"
    for corners, spacing in (
        (rim(opening, 1)[:2], 0.1),
        (rim(opening, 1) * np.nan, 0.1),
        (rim(opening, 1), 0.0),
    ):
        with pytest.raises(VolumeError):
            densify(corners, spacing)
    with pytest.raises(VolumeError):
        ring_through(np.eye(3), np.array([1.0, 0, 0]), 0.5)
    assert len(densify(np.array([[0.0, 0], [1, 0], [1, 0], [1, 1]]), 0.5)) == 7

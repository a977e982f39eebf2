"""Volumes of piles above every base: closed forms, derivatives by brute force, what sigma holds."""

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.piles import PILE_BASES, TOE_BASES, HeightError, Material, Pile
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.piles.found_piles import found_piles
from ladar_volume.piles.pile_bases import pile_part
from ladar_volume.piles.pile_site import SiteTask, made_bases, site_of
from ladar_volume.piles.pile_volumes import net_above, piles_of
from ladar_volume.piles.toe_bases import ToeBase, toe_base
from ladar_volume.piles.toe_line import PlacedSurface, toe_line
from ladar_volume.piles.tonnage import tonnage, total_tonnage
from ladar_volume.volume.polygon import overlap_of

QUIET = SurfaceParameters(ratio=1.0, relevant="sampled")
#: Piles: centre, radius, height.
CONES = ((-7.0, -4.0, 4.0, 2.0), (6.0, 5.0, 5.0, 3.0))
#: Slope of the ground.
SLOPE = (0.03, -0.02)


def octagon(x, y, r, corners=8):
    a = 2.0 * np.pi * (np.arange(corners) + 0.3) / corners
    return np.column_stack([x + r * np.cos(a), y + r * np.sin(a)])


def ring_area(ring):
    x, y = ring.T
    return 0.5 * float(x @ np.roll(y, -1) - np.roll(x, -1) @ y)


def site(seed=0, noise=0.0, count=6000, half=15.0):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half, half, (count, 2))
    z = 100.0 + xy @ SLOPE
    for x, y, r, h in CONES:
        z = z + np.maximum(0.0, h * (1.0 - np.hypot(xy[:, 0] - x, xy[:, 1] - y) / r))
    return np.column_stack([xy, z + rng.normal(0.0, noise, count)])


def outlines():
    # far enough from the toe for all triangles under the line to be ground
    return [Pile(f"P{k}", octagon(x, y, r + 1.5)) for k, (x, y, r, _) in enumerate(CONES)]


def surface_of(points, sigma=0.01):
    return cloud_surface(points, QUIET, sigma)


def volumes(surface, base, chosen=True, parameters=None, second=None, piles=None):
    task = SiteTask(parameters or Parameters(), base, chosen, base, second)
    return piles_of(surface, piles or outlines(), task, lambda words: None)


def cone(k):
    _, _, r, h = CONES[k]
    return math.pi * r * r * h / 3.0


@pytest.fixture(scope="module")
def quiet():
    return surface_of(site())


@pytest.mark.parametrize("base", ["ground", "site_ground", "toe_plane", "toe_tin", "toe_mean"])
def test_on_sloping_ground_every_fitted_base_gives_the_cone(quiet, base):
    for k, pile in enumerate(volumes(quiet, base).piles):
        assert pile.volume.net_m3 == pytest.approx(cone(k), rel=4e-3)  # chords of the cone
        assert pile.volume.area_m2 == pytest.approx(ring_area(outlines()[k].ring), rel=1e-9)


@pytest.mark.parametrize("base", ["toe_plane", "toe_tin", "toe_mean", "ground", "site_ground"])
def test_bases_of_one_plane_agree_to_rounding(quiet, base):
    named, plane = volumes(quiet, base), volumes(quiet, "toe_plane")
    for one, two in zip(named.piles, plane.piles, strict=True):
        assert one.volume.net_m3 == pytest.approx(two.volume.net_m3, abs=1e-6)


def test_lowest_and_highest_toe_are_those_of_the_outline_corners(quiet):
    for name, sign in (("toe_lowest", -1.0), ("toe_highest", 1.0)):
        for k, pile in enumerate(volumes(quiet, name).piles):
            ring = outlines()[k].ring
            x, y = CONES[k][:2]
            middle, corner = np.array([x, y]) @ SLOPE, np.max(sign * (ring @ SLOPE)) * sign
            want = cone(k) + (middle - corner) * ring_area(ring)
            # the running mean of seven places rounds the corner off
            assert pile.volume.net_m3 == pytest.approx(want, abs=0.02 * ring_area(ring))


@pytest.mark.parametrize("name", PILE_BASES)
def test_every_net_volume_has_the_derivatives_of_brute_force(name):
    points = site(3, 0.01, 700)
    pile = Pile("P", octagon(*CONES[1][:2], 6.3))
    fixed = Parameters()

    def net_of(p):
        surface = surface_of(p)
        where = site_of(surface, [pile], fixed)
        part = pile_part(surface, pile)
        base = made_bases(where, part, fixed)[name]
        return net_above(part, base), surface

    net, surface = net_of(points)
    gradient = np.zeros(len(points))
    gradient[surface.representation.tin.source] = net.gradient
    rows = np.argsort(-np.abs(gradient))[:40:8]
    if name in ("toe_lowest", "toe_highest"):
        # the bootstrap is no smooth function of one height: the sum over all is that of a level
        lifted = net_of(points + np.array([0.0, 0.0, 0.5]))[0]
        assert lifted.net_m3 == pytest.approx(net.net_m3, abs=1e-6)
        assert gradient.sum() == pytest.approx(0.0, abs=1e-6)
        return
    for row in rows:
        step = np.zeros_like(points)
        step[row, 2] = 1e-5
        more, less = net_of(points + step)[0].net_m3, net_of(points - step)[0].net_m3
        assert (more - less) / 2e-5 == pytest.approx(gradient[row], rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("name", ["toe_plane", "toe_tin"])
def test_cut_has_the_derivatives_of_brute_force(name):
    points = site(4, 0.01, 700)
    pile = Pile("P", octagon(*CONES[1][:2], 6.3))

    def cut_of(p):
        task = SiteTask(Parameters(), name, True, name, None, correct=False)
        found = piles_of(surface_of(p), [pile], task, lambda words: None).piles[0]
        return found.volume.cut_raw_m3, found.gradients[0]

    _, (surface, held) = cut_of(points)
    columns = np.zeros((len(surface.representation.tin.vertices), 2))
    held.add_to(columns)
    gradient = np.zeros(len(points))
    gradient[surface.representation.tin.source] = columns[:, 1]
    for row in np.argsort(-np.abs(gradient))[:40:10]:
        step = np.zeros_like(points)
        step[row, 2] = 1e-5
        slope = (cut_of(points + step)[0] - cut_of(points - step)[0]) / 2e-5
        assert slope == pytest.approx(gradient[row], rel=2e-3, abs=1e-4)


@pytest.mark.parametrize("name", PILE_BASES)
def test_a_turned_and_shifted_site_has_the_same_volumes(quiet, name):
    turn, shift = 0.7, np.array([431000.0, 5120000.0, -40.0])
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points = site()
    moved = np.column_stack([points[:, :2] @ R.T, points[:, 2]]) + shift
    piles = [Pile(p.name, p.ring @ R.T + shift[:2]) for p in outlines()]
    one, two = volumes(quiet, name), volumes(surface_of(moved), name, piles=piles)
    for a, b in zip(one.piles, two.piles, strict=True):
        # coordinates of 5,000 km keep nine digits behind the point; places along the line move by
        # as much, and a quadratic through a circle magnifies it
        loose = 3e-3 if name in ("toe_lowest", "toe_highest", "toe_quadratic") else 1e-6
        assert b.volume.net_m3 == pytest.approx(a.volume.net_m3, rel=loose)


def test_a_second_surface_is_the_base_within_each_outline(quiet):
    bare = site()
    bare[:, 2] = 100.0 + bare[:, :2] @ SLOPE
    rng = np.random.default_rng(5)
    other = rng.uniform(-15.0, 15.0, (3000, 2))
    below = surface_of(np.column_stack([other, 99.5 + other @ SLOPE]))
    found = volumes(quiet, "second", second=below)
    for k, pile in enumerate(found.piles):
        area = ring_area(outlines()[k].ring)
        assert pile.volume.net_m3 == pytest.approx(cone(k) + 0.5 * area, rel=2e-3)
        assert pile.volume.cut_m3 == pytest.approx(pile.volume.net_m3, abs=1e-6)
    alone = volumes(surface_of(bare), "second", second=below)
    assert alone.total.net_m3 == pytest.approx(
        0.5 * sum(ring_area(p.ring) for p in outlines()), rel=1e-9
    )


def test_a_second_surface_that_ends_within_an_outline_is_refused(quiet):
    half = site()[site()[:, 0] > -7.0]
    found = volumes(quiet, "second", second=surface_of(half))
    assert [r.pile.name for r in found.refused_piles] == ["P0"]
    assert found.refused_piles[0].error.reason == "pile_second"
    assert "pile_refused" in [d.name for d in found.verdict.doubts]
    assert [p.pile.name for p in found.piles] == ["P1"]


def test_noise_of_the_total_is_that_of_the_summed_gradients():
    surface = surface_of(site(1, 0.01), 0.01)
    found = volumes(surface, "site_ground")
    both = np.zeros((len(surface.representation.tin.vertices), 2))
    for p in found.piles:
        p.gradients[0][1].add_to(both)
    noise = 0.01**2 * float((both[:, 0] ** 2).sum())
    assert found.total.budget_m6["noise"] == pytest.approx(noise, rel=1e-9)
    alone = sum(p.volume.budget_m6["noise"] for p in found.piles)
    # one ground under both: more than of two that are independent
    assert noise > 1.01 * alone
    assert found.total.net_m3 == pytest.approx(sum(p.volume.net_m3 for p in found.piles))
    assert found.total.sigma_m3**2 == pytest.approx(sum(found.total.budget_m6.values()), rel=1e-9)


@pytest.mark.parametrize("base", ["toe_plane", "toe_tin", "toe_lowest", "toe_highest"])
def test_intervals_of_toe_bases_hold(base):
    z = []
    for seed in range(4):
        for k, pile in enumerate(volumes(surface_of(site(seed, 0.02), 0.02), base).piles):
            ring, truth = outlines()[k].ring, cone(k)
            if base in ("toe_lowest", "toe_highest"):
                sign = -1.0 if base == "toe_lowest" else 1.0
                corner = np.max(sign * (ring @ SLOPE)) * sign
                truth += (np.array(CONES[k][:2]) @ SLOPE - corner) * ring_area(ring)
            z.append((pile.volume.net_m3 - truth) / pile.volume.sigma_m3)
    assert np.sqrt(np.mean(np.square(z))) < 1.6
    assert np.sqrt(np.mean(np.square(z))) > 0.2


def test_extremes_of_a_noisy_level_line_are_not_beyond_it():
    rng = np.random.default_rng(11)
    levels = []
    for _ in range(30):
        xy = rng.uniform(-6.0, 6.0, (1500, 2))
        surface = surface_of(np.column_stack([xy, rng.normal(0.0, 0.05, len(xy))]), 0.05)
        placed = PlacedSurface.of(surface.representation.tin)
        line = toe_line(placed, octagon(0.0, 0.0, 4.0))
        ring, variance = octagon(0.0, 0.0, 4.0), surface.vertex_variance
        base = toe_base("toe_lowest", placed, ring, line, variance)
        raw = float(line.height_m.min())
        levels.append((raw, float(base.plane.beta[0])))
    raw, corrected = np.mean(levels, axis=0)
    # noise alone pulls the lowest of a hundred places down by 2 sigma; most of it is taken off
    assert raw < -0.08
    assert abs(corrected) < 0.5 * 0.05


def test_an_outline_on_the_slope_of_the_pile_is_doubtful():
    cut = [Pile("P", octagon(*CONES[1][:2], 3.0))]
    for base in ("ground", "toe_plane", "toe_tin"):
        found = volumes(surface_of(site()), base, piles=cut)
        assert "cut" in [d.name for d in found.piles[0].verdict.doubts]


def test_outlines_that_overlap_or_leave_the_survey_are_doubtful(quiet):
    twice = [Pile("A", octagon(6.0, 5.0, 6.0)), Pile("B", octagon(6.5, 5.0, 6.0))]
    both = volumes(quiet, "level", piles=twice).verdict
    assert "outlines_overlap" in [d.name for d in both.doubts]
    beyond = [Pile("A", octagon(11.0, 5.0, 6.0))]
    found = volumes(quiet, "level", piles=beyond).piles[0]
    assert "outline_unseen" in [d.name for d in found.verdict.doubts]


def test_piles_without_a_surface_are_refused_and_the_others_stay(quiet):
    piles = [*outlines(), Pile("far", octagon(90.0, 0.0, 3.0)), Pile("tiny", octagon(0, 0, 1e-4))]
    found = volumes(quiet, "toe_plane", piles=piles)
    assert [p.pile.name for p in found.piles] == ["P0", "P1"]
    assert {r.error.reason for r in found.refused_piles} == {"volume_no_triangle", "pile_small"}
    with pytest.raises(VolumeError, match="no part of the surface"):
        volumes(quiet, "toe_plane", piles=piles[2:3])


def test_bases_nobody_chose_between_widen_sigma():
    surface = surface_of(site(2, 0.03), 0.03)
    named, free = volumes(surface, "ground"), volumes(surface, "ground", chosen=False)
    for a, b in zip(named.piles, free.piles, strict=True):
        nets = [b.bases[name].net_m3 for name in ("ground", "toe_plane", "toe_tin")]
        assert b.volume.budget_m6["base_choice"] == pytest.approx(np.ptp(nets) ** 2 / 12.0)
        assert "base_choice" not in a.volume.budget_m6
        assert b.volume.net_m3 == a.volume.net_m3
    lines = [math.sqrt(p.volume.budget_m6["base_choice"]) for p in free.piles]
    assert math.sqrt(free.total.budget_m6["base_choice"]) == pytest.approx(sum(lines))


def test_errors_that_all_heights_share_lift_a_level_and_no_base_of_the_same_survey(quiet):
    shared = dataclasses.replace(quiet, shared_errors=(HeightError("datum", 0.02),))
    level = Parameters()
    level = dataclasses.replace(level, volume=dataclasses.replace(level.volume, level_m=100.0))
    found = volumes(shared, "level", parameters=level)
    for pile in found.piles:
        want = (0.02 * pile.volume.area_m2) ** 2
        assert pile.volume.budget_m6["datum"] == pytest.approx(want, rel=1e-9)
    total = (0.02 * found.total.area_m2) ** 2
    assert found.total.budget_m6["datum"] == pytest.approx(total, rel=1e-9)
    for base in ("ground", "toe_plane", "toe_tin", "toe_lowest"):
        for pile in volumes(shared, base).piles:
            assert pile.volume.budget_m6["datum"] < 1e-12


def test_found_piles_are_the_bodies_with_their_outlines(quiet):
    found = found_piles(quiet, Parameters())
    assert len(found) == 2
    total = volumes(quiet, "toe_plane", piles=found)
    assert [p.volume.net_m3 for p in total.piles] == pytest.approx([cone(1), cone(0)], rel=0.01)


@pytest.mark.parametrize("is_found", [True, False])
def test_what_was_found_by_rising_and_lies_below_its_base_is_doubtful(is_found):
    """A pit that somebody drew may lie below its ground; what rises above the site may not."""
    r = site(1, 0.01)
    turned = np.column_stack([r[:, :2], 2.0 * (100.0 + r[:, :2] @ SLOPE) - r[:, 2]])
    piles = [dataclasses.replace(pile, is_found=is_found) for pile in outlines()[:1]]
    (pile,) = volumes(surface_of(turned), "toe_plane", piles=piles).piles
    assert pile.volume.net_m3 < -0.9 * cone(0)
    names = {doubt.name for doubt in pile.verdict.doubts}
    assert ("below_base" in names) == is_found


def test_places_without_a_surface_take_the_heights_of_their_neighbours(quiet):
    tin = quiet.representation.tin
    middle = tin.vertices[tin.triangles, :2].mean(axis=1)
    ring = octagon(6.0, 5.0, 6.5)
    hole = np.hypot(*(middle - ring[0]).T) < 0.8
    holed = dataclasses.replace(tin, relevant=tin.relevant & ~hole)
    line = toe_line(PlacedSurface.of(holed), ring)
    assert 0.8 < np.mean(line.seen) < 1.0
    assert line.height_m == pytest.approx(100.0 + line.xy @ SLOPE, abs=0.05)
    assert np.allclose(np.asarray(line.by_vertex.sum(axis=1)).ravel(), 1.0)
    assert (line.length_m[~line.seen] == 0.0).all()
    with pytest.raises(VolumeError, match="% of the outline"):
        toe_line(PlacedSurface.of(tin), octagon(15.0, 15.0, 4.0))


@pytest.mark.parametrize("name", TOE_BASES)
def test_a_concave_outline_has_every_toe_base(quiet, name):
    ring = np.array([[0, 0], [11, -1], [12, 12], [5, 11.8], [5, 10.6], [1, 11]], float) - [0, 0.2]
    placed = PlacedSurface.of(quiet.representation.tin)
    base = toe_base(name, placed, ring, toe_line(placed, ring), np.zeros(6000))
    assert isinstance(base, ToeBase)
    if base.tin is not None:
        p = base.tin.vertices[base.tin.triangles[base.tin.relevant]]
        u, v = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        area = 0.5 * float((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum())
        assert area == pytest.approx(ring_area(ring), rel=1e-9)


def test_tonnes_hold_the_density_and_its_sigma():
    mass = tonnage(100.0, 2.0, Material("gravel", 1.6, 0.05))
    assert (mass.mass_t, mass.sigma_t) == pytest.approx((160.0, math.hypot(3.2, 5.0)))
    bare = tonnage(100.0, 2.0, Material("gravel", 1.6))
    assert bare.sigma_t == pytest.approx(3.2)
    # one density is wrong in both piles alike; two are not
    alike = total_tonnage([mass, mass], ["gravel", "gravel"], 4.0)
    apart = total_tonnage([mass, mass], ["gravel", "sand"], 4.0)
    assert alike.sigma_t == pytest.approx(math.hypot(4.0, 10.0))
    assert apart.sigma_t == pytest.approx(math.hypot(4.0, 5.0, 5.0))


def test_overlap_of_two_rings_is_the_area_they_share():
    ell = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]], float)
    square = np.array([[0.5, 0.5], [2.5, 0.5], [2.5, 2.5], [0.5, 2.5]])
    # what the L has of the square: a strip along each of its legs
    want = 2.0 * 0.5 + 0.5 * 1.5
    for one, two in ((ell, square), (square, ell), (ell[::-1], square), (ell, square[::-1])):
        assert overlap_of(one, two) == pytest.approx(want, rel=1e-12)
    assert overlap_of(ell, square + 9.0) == 0.0
    assert overlap_of(ell, ell) == pytest.approx(5.0, rel=1e-12)

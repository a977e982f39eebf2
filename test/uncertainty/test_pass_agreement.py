"""Residuals of patches against what the budget says of them."""

import dataclasses
import math

import numpy as np
import pytest

from ladar_volume.cli.tables.result_table import told_by_passes
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import Agreement, SourceAgreement, Volume
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.pass_agreement import (
    OF_SLOPES,
    Scatter,
    beside_steep_faces,
    cover_scatter,
    dispersion,
    own_scatter,
    pass_agreement,
    patch_scatter,
    plain_patches,
    scatter_by_source,
    sideways_shift,
    source_agreement,
)
from ladar_volume.volume.field_checks.field_verdict import (
    budget_scales,
    scatters_slopes,
    variance_ratio,
    with_passes,
)
from test.scenes.volume_surfaces import platform, surface_update

BUDGET = BudgetParameters()


def twice_seen(scatter_m=0.012):
    """Patches seen in two time bins, 40 s apart, that scatter so much about their surface."""
    update = surface_update(lambda x, y: 0.0 * x, noise=0.005)
    one, m = update.patches, len(update.patches)
    bins = np.stack([one.nav_bin, one.nav_bin + 40], axis=1).ravel()
    return dataclasses.replace(
        one,
        sigma=np.full(m, scatter_m),
        used=np.full(m, 100, np.int32),
        nav_start=2 * np.arange(m + 1),
        nav_bin=bins,
        M_nav=np.repeat(0.5 * one.M_nav, 2, axis=0),
    )


def navigation(patches):
    """Bins of a platform that turns round between the two passes."""
    nav = NavigationBins(1.0)
    there, back = platform(), platform()
    t0 = int(there.t_ns[0])
    high = np.tile([0.0, 0.0, 20.0], (len(there), 1))
    turned = np.tile([0.0, 0.0, 1.0, 0.0], (len(back), 1))
    late = there.t_ns >= t0 + 30 * 10**9
    q = np.where(late[:, None], turned, there.q_map_body)
    nav.add(dataclasses.replace(there, p_map_body=high, q_map_body=q))
    return nav


def test_dispersion_is_that_of_drawn_errors():
    rng = np.random.default_rng(5)
    t, shares = np.array([0.0, 3.0, 11.0, 30.0]), (0.2, 0.1, 20.0)
    u = rng.normal(size=(4, 3))
    apart = np.abs(t[:, None] - t)
    C = 0.2 + 0.7 * np.exp(-apart / 20.0) + 0.1 * np.eye(4)
    drawn = np.einsum("ij,njk->nik", np.linalg.cholesky(C), rng.normal(size=(200_000, 4, 3)))
    effect = (drawn * u).sum(axis=2)
    found = dispersion(np.array([0, 4]), t, u, shares)[0]
    assert found == pytest.approx(effect.var(axis=1).mean(), rel=0.01)
    same = np.tile(u[:1], (4, 1))  # a constant does the same to all passes: nothing is seen of it
    assert dispersion(np.array([0, 4]), t, same, (1.0, 0.0, 1.0))[0] == pytest.approx(
        0.0, abs=1e-12
    )


def test_a_boresight_is_seen_between_opposite_passes_and_a_lever_arm_up_is_not():
    patches = twice_seen()
    source = scatter_by_source(patches, np.arange(len(patches)), navigation(patches), BUDGET)
    far = np.hypot(*patches.centre[:, :2].T)
    # flown both ways, roll and pitch act the other way round: the whole effect is about the mean
    x, y = patches.centre[:, :2].T
    by_hand = (BUDGET.boresight_sigma_rad[0] * y) ** 2 + (BUDGET.boresight_sigma_rad[1] * x) ** 2
    assert source["boresight"] == pytest.approx(by_hand, rel=1e-6, abs=1e-12)
    assert source["lever_laser"].max() < 1e-9 and source["attitude"][far > 5.0].min() > 0.0
    assert source["noise"].min() >= (0.99 * BUDGET.range_noise_m * 0.8) ** 2


def agreement(patches, nav):
    return pass_agreement(patch_scatter(patches, nav, BUDGET), patches, nav, BUDGET, 0.6)


def test_a_true_budget_stands_and_a_wrong_one_is_refuted():
    patches = twice_seen()
    nav = navigation(patches)
    good = agreement(patches, nav)
    assert not good.refuted and good.p_value > 0.05
    assert good.predicted_m == pytest.approx(0.012, rel=0.35)
    bad = agreement(twice_seen(0.080), nav)
    assert bad.refuted and bad.p_value < 1e-3 and bad.factor > 25.0
    assert patch_scatter(surface_update(lambda x, y: 0.0 * x).patches, nav, BUDGET) is None


def test_ground_that_scatters_more_than_the_body_is_overgrown():
    patches = twice_seen()
    ground = patches.centre[:, 0] < 0.0
    for scatter, least in ((0.012, 0.0), (0.025, 0.015)):
        sigma = np.where(ground, scatter, 0.012)
        made = dataclasses.replace(patches, sigma=sigma)
        found = cover_scatter(patch_scatter(made, navigation(made), BUDGET), ground, ~ground)
        assert (found == 0.0) if least == 0.0 else least < found < scatter


def test_grass_is_told_where_the_slopes_scatter_too():
    """What is wrong with attitudes scatters slopes: -29 m³ of an error were told as 0.7."""
    patches = twice_seen()
    ground = patches.centre[:, 0] < 0.0
    made = dataclasses.replace(patches, sigma=np.where(ground, 0.024, 0.02))
    scatter = patch_scatter(made, navigation(made), BUDGET)
    assert cover_scatter(scatter, ground, ~ground) == 0.0
    more = math.sqrt(0.024**2 - 0.02**2)
    found = cover_scatter(scatter, ground, ~ground, OF_SLOPES)
    assert found == pytest.approx(more, rel=0.2)


def test_a_body_that_scatters_more_than_its_budget_is_rough_or_overgrown():
    patches = twice_seen()
    body = patches.centre[:, 0] < 0.0
    for scatter, other in ((0.012, 0.012), (0.018, 0.05), (0.03, 0.012)):
        made = dataclasses.replace(patches, sigma=np.where(body, scatter, other))
        found = own_scatter(patch_scatter(made, navigation(made), BUDGET), body)
        assert found == (pytest.approx(scatter, rel=0.15) if scatter > 0.02 else 0.0)
        assert own_scatter(patch_scatter(made, navigation(made), BUDGET), body & ~body) == 0.0


def test_about_the_top_of_a_cone_and_along_its_toe_returns_scatter_by_its_shape():
    """A clean pile filtered with a radius of 1 m was overgrown: 295 ± 12 m³, and is 295.3 ± 0.7."""
    x, y = (c.ravel() for c in np.meshgrid(*2 * [np.arange(-10.0, 10.1, 0.5)]))
    r = np.hypot(x, y)
    centre = np.column_stack([x, y, np.maximum(0.0, 0.6 * (7.0 - r))])
    n = np.column_stack([np.where(r < 7.0, 0.6 * c / np.maximum(r, 0.1), 0.0) for c in (x, y)])
    n = np.column_stack([n, np.ones(len(r))]) / np.hypot(np.hypot(*n.T), 1.0)[:, None]
    every = np.arange(len(r))
    plain = plain_patches(centre, n, every, 1.0, 2)
    assert not plain[(r < 2.0) | (abs(r - 7.0) < 0.3)].any()
    assert plain[(r > 4.5) & (r < 5.5)].all() and plain[r > 9.0].all()
    assert np.count_nonzero(plain_patches(centre, n, every, 1.0, 1)) < np.count_nonzero(plain)
    assert plain_patches(centre, n, every, 0.55, 2)[(r > 2.0) & (r < 6.0)].all()
    assert plain_patches(centre, n, every[r < 2.0], 1.0, 2).all()  # nothing else to ask


LINES = {"noise": 0.01, "position": 0.04, "boresight": 0.09, "base_surface": 0.25}
VOLUME = Volume(
    volume_m3=100.0,
    sigma_m3=math.sqrt(sum(LINES.values())),
    confidence=0.95,
    coverage_factor=1.96,
    cut_m3=100.0,
    fill_m3=0.0,
    area_m2=50.0,
    base="level",
    base_same_survey=False,
    centroid_map=(0.0, 0.0, 0.0),
    budget_m6=LINES,
    sigma_tau_range_m3=(0.5, 0.7),
    sigma_naive_m3=0.1,
    outline=np.zeros((0, 2)),
    vertices=1,
    triangles=1,
    t_ns=0,
)
REFUTED = Agreement(0.08, 0.012, 9.0, 10.0, 1e-9, True)


def test_a_refuted_budget_is_scaled_warned_of_or_refused():
    v = with_passes(VOLUME, REFUTED, "scale")
    assert v.budget_m6 == pytest.approx({**LINES, "position": 0.36, "boresight": 0.81})
    assert v.sigma_m3**2 == pytest.approx(sum(v.budget_m6.values()))
    low, high = v.sigma_tau_range_m3
    assert low < v.sigma_m3 < high
    (doubt,) = v.verdict.doubts
    assert doubt.name == "budget" and "80 mm" in doubt.text and doubt.value == 9.0
    warned = with_passes(VOLUME, REFUTED, "warn")
    assert warned.sigma_m3 == VOLUME.sigma_m3 and not warned.verdict.sound
    with pytest.raises(VolumeError, match="lie apart"):
        with_passes(VOLUME, REFUTED, "refuse")
    true = dataclasses.replace(REFUTED, refuted=False)
    assert with_passes(VOLUME, true, "scale").verdict.sound
    assert repr(with_passes(VOLUME, None, "scale")) == repr(VOLUME)


def group(name, scale):
    return SourceAgreement(name, 0.004, scale, 10.0, 1e-6, True, 0.5, scale)


def test_a_refuted_group_scales_its_own_lines_alone():
    sources = (group("boresight", 4.0), group("position", 1.0), group("noise", 3.0))
    found = dataclasses.replace(REFUTED, sources=sources)
    v = with_passes(VOLUME, found, "scale")
    assert v.budget_m6 == pytest.approx({**LINES, "boresight": 0.36, "noise": 0.03})
    assert v.sigma_m3**2 == pytest.approx(sum(v.budget_m6.values()))
    (doubt,) = v.verdict.doubts
    assert "boresight 2 ± 0.1 times" in doubt.text and "position" not in doubt.text
    assert variance_ratio(VOLUME, found, "scale") == pytest.approx(
        (v.sigma_m3 / VOLUME.sigma_m3) ** 2
    )
    assert with_passes(VOLUME, found, "warn").sigma_m3 == VOLUME.sigma_m3
    rough = dataclasses.replace(found, refuted=False, sources=(group("noise", 3.0),))
    quiet = with_passes(VOLUME, rough, "scale")  # roughness is no disagreement of the passes
    assert quiet.verdict.sound and quiet.budget_m6 == pytest.approx({**LINES, "noise": 0.03})
    joint = budget_scales(found, "scale", ["calibration", "boresight_second_order", "attitude"])
    assert joint == {"calibration": 4.0, "boresight_second_order": 16.0, "attitude": 1.0}


def sloping(jump, own_m=0.0, seed=3):
    """Patches of any slope up to 35 degrees whose passes lie a jump (3,) m apart, seen half by each
    pass; own_m : what patches off the level scatter besides, m.
    """
    rng = np.random.default_rng(seed)
    tilt, toward = rng.uniform(0.0, 0.6, 240), rng.uniform(0.0, 2.0 * math.pi, 240)
    n = np.stack(
        [np.sin(tilt) * np.cos(toward), np.sin(tilt) * np.sin(toward), np.cos(tilt)], axis=1
    )
    noise = np.full(240, 0.012**2)
    square = noise * rng.chisquare(60, 240) / 60 + 0.25 * (n @ jump) ** 2 + (own_m * tilt) ** 2
    return Scatter(np.arange(240), square, {"noise": noise}), n


def test_patches_beside_a_wall_are_not_asked_for_a_shift():
    x = np.arange(40) * 0.25
    centre, normal = np.stack([x, 0 * x, 0 * x], axis=1), np.tile((0.0, 0.0, 1.0), (40, 1))
    assert not beside_steep_faces(centre, normal).any()
    normal[20] = (1.0, 0.0, 0.0)
    assert np.flatnonzero(beside_steep_faces(centre, normal)).tolist() == list(range(17, 24))


@pytest.mark.parametrize("jump", [(0.12, 0.0, 0.0), (0.05, 0.09, 0.02), (-0.08, 0.08, 0.0)])
def test_a_jump_sideways_is_found_with_its_size_and_direction(jump):
    found, normal = sloping(np.array(jump))
    size, toward = sideways_shift(found, found.unexplained_m2, normal)
    assert size == pytest.approx(math.hypot(*jump[:2]), rel=0.2)
    apart = (toward - math.degrees(math.atan2(jump[1], jump[0])) + 90.0) % 180.0 - 90.0
    assert abs(apart) < 12.0


@pytest.mark.parametrize(("jump", "own_m"), [((0, 0, 0), 0.0), ((0, 0, 0), 0.03), ((0, 0, 0.1), 0)])
def test_rough_slopes_and_a_jump_upwards_are_no_jump_sideways(jump, own_m):
    found, normal = sloping(np.array(jump), own_m)
    assert sideways_shift(found, found.unexplained_m2, normal) == (0.0, 0.0)


def test_a_group_alone_to_blame_takes_what_the_others_leave():
    part = {name: 4e-6 for name in ("beams", "boresight", "attitude", "position")}
    part |= {"lever_laser": 1e-8, "lever_antenna": 1e-8}
    found = {s.name: s for s in source_agreement(part, 60e-6, 40.0, BUDGET)}
    assert found["beams"].factor == pytest.approx((60 - 12.02) / 4)
    assert found["beams"].p_value < 1e-30 < found["boresight"].p_value < 1e-4
    assert not found["lever_arms"].visible and math.isnan(found["lever_arms"].p_value)
    true = source_agreement(part, sum(part.values()), 40.0, BUDGET)
    assert all(s.factor == pytest.approx(1.0) and s.p_value > 0.1 for s in true if s.visible)


def test_the_budget_table_shows_the_components():
    told = told_by_passes({"passes": {"sources": [dataclasses.asdict(group("beams", 9.0))]}})
    assert told == dict.fromkeys(("beam_range", "beam_vertical"), "3 ± 0.08, refuted")
    unknown = dataclasses.replace(group("attitude", 1.0), sigma=math.nan)
    assert told_by_passes({"passes": {"sources": [dataclasses.asdict(unknown)]}}) == {}
    assert told_by_passes({"passes": None}) == {} == told_by_passes({})


def test_beams_alone_hide_no_plants_and_the_doubt_of_anything_else_says_that_it_may():
    for name, scale, hides in (
        ("beams", 25.0, False),
        ("attitude", 25.0, True),
        ("attitude", 5.0, False),
        ("noise", 25.0, True),
    ):
        worse = SourceAgreement(name, 0.01, scale, 10.0, 1e-9, True, 1.0, scale)
        found = Agreement(0.04, 0.012, 9.0, 10.0, 1e-9, True, (worse,))
        assert scatters_slopes(found) == hides
        doubt = with_passes(VOLUME, found, "warn").verdict.doubts[-1]
        assert doubt.name == "budget" and ("plants" in doubt.text) == hides
    assert not scatters_slopes(dataclasses.replace(found, refuted=False))

"""Kinds of troubled surveys: exact volumes, and what happens on their flights."""

import dataclasses

import numpy as np
import pytest

from ladar_volume.model.errors import SimulationError
from ladar_volume.simulation.further_troubles import ThinPile, leaves
from ladar_volume.simulation.survey import EPOCH_NS
from ladar_volume.simulation.trouble_kinds import (
    ALONE,
    APART,
    KINDS,
    TroubledSurvey,
    make_trouble,
    mixture,
)
from ladar_volume.simulation.troubled_scenes import Pile, SceneDraft

#: Kinds in which nothing is wrong.
FINE = {"clean", "steep_ground", "varied_ground", "float_spans"}


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_names_what_tells_of_it_and_keeps_an_exact_volume(kind):
    d = SceneDraft(3, kind)
    KINDS[kind](d)
    assert bool(d.names) == (kind not in FINE)
    u = np.linspace(-1.0, 1.0, 401)
    x, y = np.meshgrid(u * d.pile.a, u * d.pile.b)
    area = (u[1] - u[0]) ** 2 * d.pile.a * d.pile.b
    pile = d.later_pile or d.pile
    whole = float(pile.height(x, y).sum() * area)
    assert pile.volume_m3 == pytest.approx(whole, rel=4e-3)
    assert 0.0 < d.volume_m3 <= 1.004 * whole


def test_a_thin_pile_runs_out_with_the_square():
    thin, cone = ThinPile(8.0, 7.0, 0.0, 0.6), Pile(8.0, 7.0, 0.0, 0.6)
    assert thin.volume_m3 == pytest.approx(0.5 * cone.volume_m3)
    assert thin.height(np.array([4.0]), np.array([0.0]))[0] == pytest.approx(thin.height_m / 4.0)


def test_leaves_fill_their_ellipsoid_and_let_rays_pass():
    radii = np.array([2.0, 1.0, 0.5])
    v, t = leaves(np.random.default_rng(1), np.zeros(3), radii, 400, 0.02)
    middle = v[t].mean(axis=1) / radii
    assert len(t) == 400 and np.linalg.norm(middle, axis=1).max() < 1.1
    assert np.abs(middle.mean(axis=0)).max() < 0.15


def test_fixes_jump_from_a_moment_on():
    trouble = make_trouble("gnss_jump", 4)
    flown = TroubledSurvey.of(trouble, 4)
    never = dataclasses.replace(trouble.flight_trouble, jump_s=np.inf)
    still = dataclasses.replace(trouble, flight_trouble=never)
    t, jumped, _, _ = flown.fixes()
    apart = jumped - TroubledSurvey.of(still, 4).fixes()[1]
    late = (t - EPOCH_NS) * 1e-9 >= trouble.flight_trouble.jump_s
    assert not apart[~late].any() and 0 < np.count_nonzero(late) < len(t)
    np.testing.assert_allclose(
        apart[late], np.tile(trouble.flight_trouble.jump_m, (late.sum(), 1)), 1e-9
    )


def test_an_unknown_kind_is_refused():
    with pytest.raises(SimulationError, match="no trouble"):
        make_trouble("meteor", 1)
    with pytest.raises(SimulationError, match="no trouble 'meteor'"):
        make_trouble("grass+meteor", 1)


def test_mixtures_have_two_or_three_kinds_that_bear_each_other():
    drawn = [mixture(seed) for seed in range(300)]
    assert drawn == [mixture(seed) for seed in range(300)]
    kinds = [each.split("+") for each in drawn]
    assert {len(each) for each in kinds} == {2, 3}
    assert set().union(*kinds) == set(KINDS) - set(ALONE)
    assert not any(pair <= set(each) for pair in APART for each in kinds)


def test_a_mixture_has_the_troubles_of_its_kinds():
    d = make_trouble("thin_toe+crest_hole+gnss_jump+heaped", 2)
    assert {"thin_toe", "unseen", "budget", "changed"} <= set(d.names)
    assert d.settings["volume"]["object_height_m"] == 0.15
    assert np.isfinite(d.flight_trouble.jump_s) and d.flight_trouble.later is not None
    alone = make_trouble("heaped", 2)
    holed = make_trouble("crest_hole+heaped", 2)
    whole, cut = alone.flight_trouble.later, holed.flight_trouble.later
    assert whole is not None and cut is not None
    assert len(cut.triangles) < len(whole.triangles)

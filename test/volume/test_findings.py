"""Slow checks that are asked at a pace of their own while a survey grows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cone_pile import estimator_of, pile, update_of

from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.volume import estimator as stage
from ladar_volume.volume.field_checks import field_verdict
from ladar_volume.volume.field_checks.findings import Findings, area_and_centre

CHECKS = ("null_volumes", "readings_on", "surroundings_of", "cut_m6")


def cut_pile(x, y):
    """Half of the pile, where the survey ends."""
    return x < 0.5


@pytest.fixture
def asked(monkeypatch):
    """How often each check has been asked."""
    counts = dict.fromkeys((*CHECKS, "passes_of"), 0)

    def counted(module, name):
        check = getattr(module, name)

        def ask(*given):
            counts[name] += 1
            return check(*given)

        monkeypatch.setattr(module, name, ask)

    for name in CHECKS:
        counted(field_verdict, name)
    counted(stage, "passes_of")
    return counts


@pytest.mark.parametrize("seen", [None, cut_pile])
def test_between_two_checks_the_volume_is_that_of_the_checks(asked, seen):
    """Of the same surface, checks that were asked before say what they say now."""
    e = estimator_of(seen=seen)
    whole = e.estimate()
    once = dict(asked)
    assert once["null_volumes"] == once["passes_of"] == once["surroundings_of"] == 1
    assert once["cut_m6"] == (seen is not None)
    between = e.estimate(ask_all=False)
    assert asked == once
    assert repr(dataclasses.astuple(between.volume)) == repr(dataclasses.astuple(whole.volume))
    e.estimate()
    assert asked == {name: 2 * count for name, count in once.items()}


def test_another_body_and_other_parameters_are_asked_at_once(asked):
    e = estimator_of(seen=cut_pile)
    e.estimate()
    e.add(update_of())
    assert "cut" not in {d.name for d in e.estimate(ask_all=False).volume.verdict.doubts}
    assert asked["null_volumes"] == 2
    e.estimate(ask_all=False)
    assert asked["null_volumes"] == 2
    e.set_parameters(e.parameters)
    e.estimate(ask_all=False)
    assert asked["null_volumes"] == 3


def test_bodies_are_the_same_while_they_hardly_grow_or_move():
    tin = estimator_of().estimate().tin
    centre = tin.vertices[tin.triangles, :2].mean(axis=1)

    def disc(radius, at=(0.0, 0.0)):
        area = footprint_areas(tin.vertices, tin.triangles)
        return np.where(np.hypot(*(centre - at).T) < radius, area, 0.0)

    area, middle = area_and_centre(tin, disc(4.0))
    assert area == pytest.approx(np.pi * 16.0, rel=0.03) and np.hypot(*middle) < 0.05
    found = Findings(tin, [disc(4.0), disc(2.0, (6.0, 6.0))])
    assert found.suit(tin, [disc(4.04), disc(2.0, (6.05, 6.0))])
    assert not found.suit(tin, [disc(4.12), disc(2.0, (6.0, 6.0))])
    assert not found.suit(tin, [disc(4.0), disc(2.0, (6.3, 6.0))])
    assert not found.suit(tin, [disc(4.0)])
    assert not found.suit(tin, [disc(2.0, (6.0, 6.0)), disc(4.0)])


def test_findings_are_kept_under_body_and_name():
    tin = estimator_of(height=pile).estimate().tin
    found = Findings(tin, [np.ones(len(tin.triangles))] * 2)
    first, second = found.of_body(0), found.of_body(1)
    assert (first("a", lambda: 1), first("a", lambda: 2), first("b", lambda: 3)) == (1, 1, 3)
    assert (second("a", lambda: 4), found.of_survey("a", lambda: 5)) == (4, 5)
    with pytest.raises(ZeroDivisionError):
        second("c", lambda: 1 / 0)
    assert second("c", lambda: 6) == 6  # what failed is asked again

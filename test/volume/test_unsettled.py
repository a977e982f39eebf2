"""Outline and ground that go on changing each other."""

from dataclasses import replace

import numpy as np
import pytest
from yards import bent_site

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.parameters import Parameters
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.volume import base as own
from ladar_volume.volume.field_checks.base_readings import doubted_m6, unsettled


def site(seed, bend):
    return build_tin(bent_site(seed, bend))


def outlines(tin, monkeypatch):
    """Base and the outlines of all rounds."""
    found, before = [], own.body_outline

    def kept(*arguments):
        found.append(before(*arguments))
        return found[-1]

    monkeypatch.setattr(own, "body_outline", kept)
    base, _ = own.base_and_outline(tin, np.full(len(tin.vertices), 4e-4), Parameters())
    return base, found


def test_a_mound_on_flat_ground_settles(monkeypatch):
    base, found = outlines(site(1, 0.0), monkeypatch)
    assert base.unsettled_m3 == 0.0 and len(found) < own.MAX_ROUNDS
    assert not unsettled(base, 0.0)


@pytest.mark.parametrize("seed", range(6))
def test_bent_ground_is_said_to_settle_only_where_it_does(seed, monkeypatch):
    base, found = outlines(site(seed, 1.0), monkeypatch)
    settled = np.array_equal(found[-1], found[-2])
    assert settled == (base.unsettled_m3 == 0.0)


def test_some_bent_ground_does_not_settle(monkeypatch):
    moved = [outlines(site(seed, 1.0), monkeypatch)[0].unsettled_m3 for seed in range(6)]
    assert max(moved) > 1.0
    (doubt,) = unsettled(replace(design_surface([0.0]), unsettled_m3=max(moved)), 0.5)
    assert doubt.name == "outline_unsettled" and doubt.value == max(moved)
    assert doubted_m6([doubt]) == max(moved) ** 2


def test_volume_between_outlines_is_that_of_the_triangles_by_which_they_differ():
    tin, base = site(2, 1.0), design_surface([0.3, 0.01, -0.02])
    area = footprint_areas(tin.vertices, tin.triangles)
    rng = np.random.default_rng(3)
    one, two = rng.random((2, len(area))) < 0.5
    corner = tin.vertices[tin.triangles]
    low = 0.3 + 0.01 * corner[..., 0] - 0.02 * corner[..., 1]
    each = (corner[..., 2] - low).mean(axis=1)
    assert own.volume_between(tin, base, one, two) == pytest.approx(
        (two * area - one * area) @ each
    )

"""Lengths of base and outline follow the size of the site: volumes from a table to a mine."""

from __future__ import annotations

import numpy as np
import pytest

import ladar_volume as lv
from ladar_volume.clouds.cloud_surface import cloud_surface
from ladar_volume.clouds.sampling.site_lengths import (
    HEIGHTS,
    WIDTHS,
    length_facts,
    site_lengths,
    size_of,
)
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.surface_parameters import SurfaceParameters

#: Volume, m³, of the cone of :func:`cone` of scale 1.
TRUE = np.pi * 8.0**2 * 4.0 / 3.0


def cone(scale: float, noise: float = 0.008, n: int = 6000):
    """A cone of 4 m on a level square of 40 m, times the scale, far from the origin."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(-20.0, 20.0, (n, 2))
    z = np.maximum(4.0 - 0.5 * np.hypot(*xy.T), 0.0) + rng.normal(0.0, noise, n)
    return scale * np.c_[xy, z] + np.array([500.0, -300.0, 20.0])


def lengths(scale: float, noise: float = 0.008, named=()):
    """The facts of :func:`site_lengths` for a cone."""
    surface = cloud_surface(cone(scale, noise), SurfaceParameters(ratio=1.0), scale * noise)
    return length_facts(site_lengths(Parameters(), size_of(surface), named))


@pytest.mark.parametrize("scale", [0.005, 0.05, 1.0, 100.0])
def test_a_cone_of_any_size_has_its_volume(scale):
    """From 2 cm to 400 m high, with nothing set, above the ground that is found."""
    found = lv.volume(cone(scale))
    truth = TRUE * scale**3
    assert abs(found.net_m3 - truth) < 2.5 * found.sigma_m3
    assert 2e-4 * truth < found.sigma_m3 < 3e-3 * truth
    assert found.facts["verdict"]["status"] == "sound"


@pytest.mark.parametrize("pair", [(0.002, 0.2), (20.0, 200.0)])
def test_volumes_go_with_the_cube_of_the_scale(pair):
    one, two = (lv.volume(cone(scale)) for scale in pair)
    cube = (pair[1] / pair[0]) ** 3
    assert one.net_m3 * cube == pytest.approx(two.net_m3, rel=1e-6)
    assert one.sigma_m3 * cube == pytest.approx(two.sigma_m3, rel=1e-3)


def test_a_yard_has_the_lengths_as_they_are():
    assert lengths(0.5) == length_facts(Parameters())


def test_noise_raises_the_height_and_spacing_the_widths():
    default = length_facts(Parameters())
    noisy = lengths(0.5, noise=0.08)
    assert noisy["object_height_m"] == pytest.approx(0.2)
    assert noisy["outline_margin_m"] == default["outline_margin_m"]
    coarse = lengths(4.0, noise=0.002)
    spacing = 160.0 / np.sqrt(6000)
    assert coarse["object_height_m"] == default["object_height_m"]
    assert coarse["outline_margin_m"] == pytest.approx(2.5 * spacing, rel=0.1)
    assert coarse["ground_ring_m"] == pytest.approx(10.0 * coarse["outline_margin_m"])


def test_what_the_user_names_stays():
    default = length_facts(Parameters())
    for name in (*HEIGHTS, *WIDTHS):
        found = lengths(0.01, named=[name])
        assert found[name] == default[name]
        assert found["min_body_m3"] < default["min_body_m3"]
    with pytest.raises(VolumeError, match=r"nothing rises more than 0\.15 m"):
        lv.volume(cone(0.005), set=["volume.object_height_m=0.15"])

"""The volume stage on partial TINs: a ratio of 1 changes nothing, below it heights are adjusted and
the variance goes through that.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from volume_surfaces import cone, platform, surface_update

from ladar_volume.model.errors import ParameterValueError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import LEAST_UPWARD
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.relevant import with_relevant
from ladar_volume.volume.base import base_and_outline
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.prismoids import prismoids
from ladar_volume.volume.volume_loads import result_gradients, vertex_variance

CONE = math.pi * 16.0


def sloped(x, y):
    return cone(x, y, slope=(0.02, -0.05)) + 3.0


def estimator(update, ratio, **sections):
    sections["volume"] = {"vertex_ratio": ratio, **sections.get("volume", {})}
    e = VolumeEstimator(Parameters.read({"filter": {"nav_bin_s": 1.0}, **sections}))
    e.add_platform(platform())
    e.add(update)
    return e


def test_a_ratio_of_one_is_the_full_tin_to_the_last_bit():
    update = surface_update(sloped, perturb=0.01)
    e = estimator(update, 1.0)
    estimate, points = e.estimate(), e.store.points
    v = e.parameters.volume
    plain = with_relevant(build_tin(points.r_map), v.relevant, v.max_edge_m, v.max_circumdiameter_m)
    for name in ("vertices", "triangles", "neighbours", "relevant", "source"):
        assert getattr(estimate.tin, name).tobytes() == getattr(plain, name).tobytes()
    surface = e.surface(points)
    variance = points.variance[plain.source] / np.maximum(
        points.normal[plain.source, 2] ** 2, LEAST_UPWARD**2
    )
    assert surface.fit is None and vertex_variance(surface, points).tobytes() == variance.tobytes()
    base, inside = base_and_outline(plain, variance, e.parameters)
    solid = prismoids(plain, base, inside > 0)
    assert estimate.volume.volume_m3 + estimate.volume.chord_m3 == pytest.approx(
        solid.net_m3, rel=1e-14
    )
    with_surface = result_gradients(plain, base, solid, len(points), surface)
    assert with_surface.tobytes() == result_gradients(plain, base, solid, len(points)).tobytes()


@pytest.mark.parametrize("ratio", [0.2, 1 / 3, 0.9])
def test_partial_tins_hold_the_same_volume_within_sigma(ratio):
    update = surface_update(sloped, spacing=0.25, perturb=0.01)
    full, of_part = estimator(update, 1.0).estimate(), estimator(update, ratio)
    part = of_part.estimate()
    assert len(part.tin.vertices) == pytest.approx(ratio * len(full.tin.vertices), rel=0.01)
    assert abs(part.volume.volume_m3 - full.volume.volume_m3) < full.volume.sigma_m3
    assert part.volume.volume_m3 == pytest.approx(CONE, rel=3e-3)
    assert part.volume.sigma_m3 == pytest.approx(full.volume.sigma_m3, rel=0.1)
    assert sum(part.volume.budget_m6.values()) == pytest.approx(part.volume.sigma_m3**2, rel=1e-12)
    assert (part.tin.source >= 0).all() and of_part.epoch().sigma_z().shape == (
        len(part.tin.vertices),
    )


def test_common_shift_and_yaw_cancel_through_the_adjustment():
    update = surface_update(sloped, perturb=0.01)
    for degree in (0, 1, 2):
        e = estimator(update, 1 / 3, ground={"degree": degree})
        surface = e.surface(e.store.points)
        base, inside = base_and_outline(
            surface.tin, vertex_variance(surface, e.store.points), e.parameters
        )
        position = e.store.points.r_map
        G = result_gradients(
            surface.tin, base, prismoids(surface.tin, base, inside > 0), len(position), surface
        )[:, 0]
        yaw = np.c_[-position[:, 1], position[:, 0], np.zeros(len(position))]
        assert np.abs(G.sum(axis=0)).max() < 1e-9 * np.abs(G).sum()
        assert abs((G * yaw).sum()) < 1e-8 * np.abs(G * np.abs(yaw)).sum()


def test_the_noise_line_against_sampling_with_its_own_choice_of_vertices():
    update = surface_update(sloped, spacing=0.5, noise=0.03)
    quiet = {
        "budget": {"position_bias_fraction": 0.0},
        "volume": {"outline": "polygon", "polygon_m": [-6, -6, 6, -6, 6, 6, -6, 6]},
    }
    first = estimator(update, 1 / 3, **quiet).estimate()
    patches, rng = update.patches, np.random.default_rng(7)
    row = np.searchsorted(patches.key, update.points.patch)
    X = np.c_[np.ones(len(row)), update.points.local]
    sd = np.sqrt(np.diagonal(patches.cross, axis1=1, axis2=2))
    volumes = []
    for _ in range(100):
        error = (X * (sd * rng.standard_normal(sd.shape))[row]).sum(axis=1)
        moved = dataclasses.replace(
            update.points, r_map=update.points.r_map + error[:, None] * patches.normal[row]
        )
        volumes.append(
            estimator(dataclasses.replace(update, points=moved), 1 / 3, **quiet)
            .estimate()
            .volume.volume_m3
        )
    # 100 samples: the standard error of a sigma is 7 %; every sample chooses its own vertices,
    # which the gradient holds fixed
    assert np.std(volumes) == pytest.approx(math.sqrt(first.volume.budget_m6["noise"]), rel=0.25)


def test_the_ratio_has_bounds():
    for bad in (0.0, 1.5, -1, math.nan, "a third"):
        with pytest.raises(ParameterValueError):
            Parameters.read({"volume": {"vertex_ratio": bad}})

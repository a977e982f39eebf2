"""The volume stage on synthetic filtered surfaces."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import astuple

import numpy as np
import pytest
from volume_surfaces import BIN_NS, T0, cone, piece, platform, surface_update, take_patches

from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.uncertainty.volume_budget import vertical_sigma
from ladar_volume.volume.estimator import VolumeEstimator

CONE = math.pi * 16.0


def parameters(**sections):
    """Parameters with the time bins of the synthetic surfaces."""
    return Parameters.read({"filter": {"nav_bin_s": 1.0}, **sections})


def estimator(update, p=None):
    e = VolumeEstimator(p or parameters())
    e.add_platform(platform())
    e.add(update)
    return e


def sloped(x, y):
    return cone(x, y, slope=(0.02, -0.05)) + 3.0


def same(one, other):
    a, b = one.estimate(), other.estimate()
    for f in dataclasses.fields(a.volume):
        x, y = getattr(a.volume, f.name), getattr(b.volume, f.name)
        assert np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y, f.name
    for name in ("vertices", "triangles", "neighbours"):
        assert getattr(a.tin, name).tobytes() == getattr(b.tin, name).tobytes()
    assert a.base.C_beta.tobytes() == b.base.C_beta.tobytes()
    assert one.epoch().sigma_z().tobytes() == other.epoch().sigma_z().tobytes()


def test_cone_on_a_slope():
    e = estimator(surface_update(sloped, spacing=0.25))
    r = e.estimate()
    v, sigma_z = r.volume, e.epoch().sigma_z()
    assert v.volume_m3 == pytest.approx(CONE, rel=2e-3)
    assert r.base.beta[1:] == pytest.approx([0.02, -0.05], abs=1e-6)
    assert v.volume_m3 == pytest.approx(v.cut_m3 - v.fill_m3, rel=1e-12) and v.folded_m3 >= 0.0
    assert (
        sum(v.budget_m6.values()) == pytest.approx(v.sigma_m3**2, rel=1e-12)
        and min(v.budget_m6.values()) >= 0.0
    )
    assert v.interval_m3 == (
        v.volume_m3 - v.coverage_factor * v.sigma_m3,
        v.volume_m3 + v.coverage_factor * v.sigma_m3,
    )
    assert v.coverage_factor == pytest.approx(1.959964, abs=1e-6)
    assert v.centroid_map == pytest.approx((0, 0, 3.0 + 0.75), abs=0.02)
    assert v.sigma_tau_range_m3[0] <= v.sigma_m3 <= v.sigma_tau_range_m3[1]
    assert (
        v.base == "ground of the same survey (plane)"
        and v.base_same_survey
        and v.t_ns == T0 + 100 * BIN_NS
    )
    radius = np.hypot(*v.outline.T)
    assert 4.5 < radius.min() and radius.max() < 6.0
    assert v.area_m2 == pytest.approx(polygon_area(v.outline), rel=1e-9)
    assert sigma_z.shape == (len(r.tin.vertices),) and (sigma_z > 0).all()


def test_two_threads_find_what_one_finds(monkeypatch):
    """What they read must not be written by either: repeated, since a race is lost now and then."""
    update = surface_update(sloped, perturb=0.003)

    def found():
        e = estimator(update).estimate()
        return astuple(e.volume), e.base.C_beta.tobytes()

    several = [repr(found()) for _ in range(8)]
    monkeypatch.setattr(
        "ladar_volume.volume.measured_body.run_concurrently",
        lambda one, two: (one(), two()),
    )
    assert set(several) == {repr(found())}


def polygon_area(p):
    q = np.roll(p, -1, axis=0)
    return 0.5 * float((p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]).sum())


def test_the_history_of_updates_does_not_matter():
    update = surface_update(sloped, perturb=0.003)
    m = len(update.patches)
    whole = estimator(update)
    order = np.random.default_rng(0).permutation(m)
    for rows in (order, np.arange(m)[::-1]):
        e = VolumeEstimator(parameters())
        e.add_platform(platform())
        for part in np.array_split(rows, 7):
            e.add(piece(update, part))
        same(whole, e)
    stale = surface_update(lambda x, y: sloped(x, y) + 0.4, seed=5)
    e = VolumeEstimator(parameters())
    e.add_platform(platform())
    e.add(stale)
    e.estimate()
    e.add(update)  # replaces every patch
    same(whole, e)
    extra = dataclasses.replace(
        piece(stale, np.arange(3)),
        patches=dataclasses.replace(
            take_patches(stale.patches, np.arange(3)),
            key=np.array([1, 2, 4]),
            cross_key=np.array([1, 2, 4]),
        ),
    )
    extra = dataclasses.replace(
        extra, points=dataclasses.replace(extra.points, patch=np.repeat([1, 2, 4], 4))
    )
    e.add(extra)
    assert (
        e.estimate().tin.vertices.shape[0] == len(whole.estimate().tin.vertices)
        and e.estimate().tin.duplicates == 12
    )
    nothing = piece(update, np.zeros(0, np.int64))
    e.add(dataclasses.replace(nothing, removed=np.array([1, 2, 4])))
    same(whole, e)


def test_common_shift_and_yaw_cancel_above_the_surveys_own_ground_only():
    from ladar_volume.volume.base import base_and_outline
    from ladar_volume.volume.prismoids import prismoids
    from ladar_volume.volume.volume_loads import result_gradients

    update = surface_update(sloped, perturb=0.01)
    for degree in (0, 1, 2):
        r = estimator(update, parameters(ground={"degree": degree}))
        tin = r.surface(r.store.points).tin
        base, inside = base_and_outline(tin, np.full(len(tin.vertices), 1e-4), r.parameters)
        solid = prismoids(tin, base, inside > 0)
        G = result_gradients(tin, base, solid, len(r.store.points))[:, 0]
        alone = result_gradients(tin, base, solid, len(r.store.points), coefficients=False)
        assert alone.shape[1] == 1 and np.abs(alone[:, 0] - G).max() <= 1e-12 * np.abs(G).max()
        position = r.store.points.r_map
        yaw = np.c_[-position[:, 1], position[:, 0], np.zeros(len(position))]
        scale = np.abs(G).sum()
        assert np.abs(G.sum(axis=0)).max() < 1e-11 * scale
        assert abs((G * yaw).sum()) < 1e-10 * scale
    r = estimator(update, parameters(volume={"base": "level", "level_m": 2.0, "outline": "all"}))
    solid = prismoids(
        tin,
        (base2 := base_and_outline(tin, np.full(len(tin.vertices), 1e-4), r.parameters))[0],
        base2[1] > 0,
    )
    assert solid.gradient_net.sum(axis=0)[2] == pytest.approx(solid.area_m2, rel=1e-12)


def test_the_base_decides_what_a_constant_error_does():
    budget = {
        "position_bias_fraction": 1.0,
        "position_white_fraction": 0.0,
        "attitude_bias_fraction": 1.0,
        "attitude_white_fraction": 0.0,
    }
    update = surface_update(sloped, spacing=0.25)
    own = estimator(update, parameters(budget=budget)).estimate().volume
    fixed = (
        estimator(
            update, parameters(budget=budget, volume={"base": "plane", "plane": [3.0, 0.02, -0.05]})
        )
        .estimate()
        .volume
    )
    assert own.budget_m6["position"] < 1e-3 * fixed.budget_m6["position"]
    assert fixed.sigma_naive_m3 < fixed.sigma_m3 / 5
    assert (
        not fixed.base_same_survey
        and fixed.budget_m6["base_surface"] == 0.0
        and fixed.base.startswith("given plane")
    )


def test_a_constant_position_error_above_a_given_plane_has_a_closed_form():
    budget = {"position_bias_fraction": 1.0, "position_white_fraction": 0.0}
    volume = {"base": "plane", "plane": [1.0, 0.1, 0.2], "outline": "all"}
    v = (
        estimator(
            surface_update(lambda x, y: 3.0 + 0.1 * x + 0.2 * y),
            parameters(budget=budget, volume=volume),
        )
        .estimate()
        .volume
    )
    assert v.volume_m3 == pytest.approx(2.0 * v.area_m2, rel=1e-12)
    # an east error e lifts the surface by -0.1 e, a north error n by -0.2 n, an up error u by u;
    # sensitivities are held to 2^-16 of the largest
    assert v.budget_m6["position"] == pytest.approx(
        (0.02 * v.area_m2) ** 2 * (1 + 0.1**2 + 0.2**2), rel=1e-5
    )
    # the same holds for a lever arm on a sensor that never turns
    assert v.budget_m6["lever_laser"] == pytest.approx(
        v.area_m2**2 * (0.003**2 + (0.002 * 0.1) ** 2 + (0.002 * 0.2) ** 2), rel=3e-7
    )


@pytest.mark.parametrize("line", ["position", "lever_laser", "lever_antenna"])
def test_a_common_shift_vanishes_above_the_surveys_own_ground_at_every_edge(line):
    """At toe and rim the triangles of a point lie on both faces and its normal is that of one: the
    movement along it alone leaves a part of the shift, a tenth of a metre times the length of the
    edge.
    """
    budget = {"position_bias_fraction": 1.0, "position_white_fraction": 0.0}
    update = surface_update(lambda x, y: np.clip(3.0 - np.hypot(x, y), 0.0, 1.5), spacing=0.25)
    flat = dataclasses.replace(
        update.patches, M_cal=update.patches.M_cal.copy(), M_nav=update.patches.M_nav.copy()
    )
    flat.M_cal[:, 3:] = flat.M_nav[:, 3:] = 0.0
    along_normal = dataclasses.replace(update, patches=flat)
    found, partial = (
        estimator(u, parameters(budget=budget)).estimate().volume for u in (update, along_normal)
    )
    assert math.sqrt(found.budget_m6[line]) < 1e-6 * found.volume_m3
    assert partial.budget_m6[line] > 1e4 * found.budget_m6[line]


def test_the_sigma_of_some_heights_is_that_of_all():
    e = estimator(surface_update(sloped, perturb=0.003))
    once, bit_by_bit = e.epoch().sources, e.epoch().sources
    every = np.arange(len(once.points))
    whole = vertical_sigma(once, every)
    for part in np.array_split(np.random.default_rng(2).permutation(every), 5):
        assert np.array_equal(vertical_sigma(bit_by_bit, part), whole[part])
    assert (
        np.array_equal(vertical_sigma(bit_by_bit, every), whole)
        and len(vertical_sigma(once, every[:0])) == 0
    )


def test_what_heights_share():
    """On level ground seen by a sensor that never turns: the height of the position, constant,
    wandering and white, and of a lever arm.
    """
    budget = {
        "position_bias_fraction": 0.2,
        "position_white_fraction": 0.1,
        "tau_position_s": 5.0,
        "lever_laser_sigma_m": [0.0, 0.0, 0.003],
    }
    zero = ("range_bias_sigma_m", "beam_range_sigma_m", "beam_vertical_sigma_deg", "clock_sigma_s")
    budget |= dict.fromkeys(zero, 0.0) | {
        name: [0.0, 0.0, 0.0] for name in ("boresight_sigma_deg", "lever_antenna_sigma_m")
    }
    e = VolumeEstimator(parameters(budget=budget, georeference={"max_position_gap_s": 0.25}))
    e.add_platform(platform(position=0.02, attitude=0.0))
    e.add(surface_update(lambda x, y: 3.0 + 0.0 * x, spacing=0.5))
    sources = e.epoch().sources
    some = np.arange(0, len(sources.points), 7, dtype=np.int64)
    order, C = sources.shared_covariance(some)
    t = sources.points.t_ns[some[order]] * 1e-9
    lag = np.abs(t[:, None] - t)
    white = np.where(np.eye(len(some), dtype=bool), 2.0 / 3.0, (lag == 0) / (1.0 / 0.25))
    expected = 0.003**2 + 0.02**2 * (0.2 + 0.7 * np.exp(-lag / 5.0) + 0.1 * white)
    assert (
        (lag > 0).any()
        and (np.diff(t) >= 0).all()
        and np.triu(C) == pytest.approx(np.triu(expected), rel=1e-6)
    )


def test_noise_line_and_base_covariance_against_sampling():
    update = surface_update(sloped, spacing=0.5, noise=0.03)
    quiet = parameters(budget={"position_bias_fraction": 0.0})
    first = estimator(update, quiet).estimate()
    patches, rng = update.patches, np.random.default_rng(7)
    row = np.searchsorted(patches.key, update.points.patch)
    X = np.c_[np.ones(len(row)), update.points.local]
    sd = np.sqrt(np.diagonal(patches.cross, axis1=1, axis2=2))
    volumes, betas = [], []
    for _ in range(100):
        error = (X * (sd * rng.standard_normal(sd.shape))[row]).sum(axis=1)
        moved = dataclasses.replace(
            update.points, r_map=update.points.r_map + error[:, None] * patches.normal[row]
        )
        r = estimator(dataclasses.replace(update, points=moved), quiet).estimate()
        volumes.append(r.volume.volume_m3)
        betas.append(r.base.beta)
    # 100 samples: the standard error of a sigma is 7 %
    assert np.std(volumes) == pytest.approx(math.sqrt(first.volume.budget_m6["noise"]), rel=0.2)
    assert np.std(betas, axis=0) == pytest.approx(np.sqrt(np.diag(first.base.C_beta)), rel=0.2)
    assert abs(np.mean(volumes) - first.volume.volume_m3) < 3.5 * np.std(volumes) / math.sqrt(100)


@pytest.mark.parametrize(
    "volume,expected,tolerance",
    [
        (
            {
                "base": "level",
                "level_m": 3.0,
                "outline": "polygon",
                "polygon_m": [-5, -5, 5, -5, 5, 5, -5, 5],
            },
            CONE,
            0.01,
        ),
        (
            {"base": "level", "level_m": 2.0, "outline": "all", "relevant": "all"},
            CONE + 19.5**2,
            0.01,
        ),
        (
            {"base": "ground", "outline": "polygon", "polygon_m": [-5, -5, 5, -5, 5, 5, -5, 5]},
            CONE,
            0.01,
        ),
        ({"base": "ground", "outline": "all"}, CONE, 0.01),
        ({"base": "level", "level_m": 3.0}, CONE, 0.01),
    ],
)
def test_bases_and_outlines(volume, expected, tolerance):
    v = (
        estimator(surface_update(lambda x, y: cone(x, y) + 3.0), parameters(volume=volume))
        .estimate()
        .volume
    )
    assert v.volume_m3 == pytest.approx(expected, rel=tolerance)


def test_a_second_pile_and_a_hole_in_the_ground_stay_outside():
    def scene(x, y):
        return cone(x, y) + 0.4 * cone(x - 7, y - 7, 2.0) - 0.3 * cone(x + 7.5, y + 7.5, 2.0)

    v = estimator(surface_update(scene, spacing=0.25)).estimate().volume
    assert v.volume_m3 == pytest.approx(CONE, rel=0.005)


def test_bad_points_are_counted_and_the_rest_kept():
    update = surface_update(sloped)
    r = update.points.r_map.copy()
    r[5, 2] = np.nan
    patch = update.points.patch.copy()
    patch[9:12] = 1
    e = estimator(
        dataclasses.replace(update, points=dataclasses.replace(update.points, r_map=r, patch=patch))
    )
    assert e.estimate().volume.volume_m3 == pytest.approx(CONE, rel=0.01)
    assert e.losses.as_dict() == {"point_nan": 1, "point_without_patch": 3}


def test_refusals():
    e = VolumeEstimator(parameters())
    with pytest.raises(SurfaceError):
        e.estimate()
    update = surface_update(sloped)
    e.add(update)
    with pytest.raises(VolumeError) as caught:
        e.estimate()
    assert caught.value.reason == "volume_no_navigation"
    with pytest.raises(VolumeError) as caught:
        estimator(surface_update(lambda x, y: 0.01 * x)).estimate()
    assert caught.value.reason == "volume_no_body"
    with pytest.raises(SurfaceError):
        estimator(piece(update, np.zeros(0, np.int64))).estimate()
    with pytest.raises(SurfaceError):
        estimator(
            piece(update, np.arange(1, 30)), parameters(volume={"max_edge_m": 0.01})
        ).estimate()
    with pytest.raises(GroundError):
        estimator(surface_update(lambda x, y: 1.5 * x)).estimate()
    for polygon, reason in (
        ([0, 0, 1], "volume_polygon"),
        ([50, 50, 60, 50, 60, 60], "volume_no_triangle"),
    ):
        with pytest.raises(VolumeError) as caught:
            estimator(
                update, parameters(volume={"outline": "polygon", "polygon_m": polygon})
            ).estimate()
        assert caught.value.reason == reason

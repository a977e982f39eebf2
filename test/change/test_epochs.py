"""Two surveys of one place: what they share cancels, what they do not adds up, and the interval
holds.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from epoch_surfaces import PIT, epoch, flat, moved, pit
from volume_surfaces import cone, surface_update

from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.math.se3 import exp_so3
from ladar_volume.model.choices import CALIBRATION_GROUPS
from ladar_volume.model.errors import VolumeError
from ladar_volume.registration.transform import Transform
from ladar_volume.uncertainty.epoch_budget import cross_covariance, epoch_budget, shared_columns
from ladar_volume.uncertainty.propagation import calibration_groups
from ladar_volume.volume.overlay import volumes_between


def test_volume_of_a_pit_and_its_significance():
    new, old = epoch(surface_update(pit, spacing=0.25)), epoch(surface_update(flat))
    d, _ = epoch_difference(new, old)
    assert d.volume.volume_m3 == pytest.approx(PIT, rel=1e-3)
    assert d.volume.fill_m3 - d.volume.cut_m3 == pytest.approx(-d.volume.volume_m3, rel=1e-12)
    assert (
        sum(d.volume.budget_m6.values()) == pytest.approx(d.volume.sigma_m3**2, rel=1e-12)
        and min(d.budget.lines.values()) >= 0.0
    )
    assert d.z == d.volume.volume_m3 / d.volume.sigma_m3 and d.p_value == pytest.approx(
        math.erfc(abs(d.z) / math.sqrt(2))
    )
    assert d.volume.sigma_tau_range_m3[0] <= d.volume.sigma_m3 <= d.volume.sigma_tau_range_m3[1]
    assert d.volume.centroid_map[:2] == pytest.approx((0.0, 0.0), abs=0.01)
    back, _ = epoch_difference(old, new)
    assert back.volume.volume_m3 == pytest.approx(-d.volume.volume_m3, rel=1e-9)
    assert back.volume.sigma_m3 == pytest.approx(d.volume.sigma_m3, rel=1e-9)


def test_a_shared_calibration_cancels_and_a_separate_one_does_not():
    new, old = epoch(surface_update(pit, spacing=0.25)), epoch(surface_update(flat))
    shared = epoch_difference(new, old)[0].budget
    apart = epoch_difference(new, old, CALIBRATION_GROUPS)[0].budget
    area = 19.5**2
    for group, axis in (("lever_laser", 0.003), ("lever_antenna", 0.003)):
        # separate: each survey's height error is the lever arm's vertical one, over all of the area
        assert apart.lines[group] == pytest.approx(2.0 * (area * axis) ** 2, rel=0.15)
        assert shared.lines[group] < 1e-4 * apart.lines[group]
    assert shared.lines["boresight"] < 1e-3 * apart.lines["boresight"]
    assert shared.lines["clock"] == pytest.approx(apart.lines["clock"])
    for line in ("noise", "noise_previous", "position", "position_previous", "attitude"):
        assert shared.lines[line] == apart.lines[line]
    assert shared.sigma_separate == pytest.approx(
        apart.sigma, rel=1e-9
    ) and apart.sigma_separate == pytest.approx(apart.sigma, rel=1e-9)


def turned(update, theta):
    """The same survey with a boresight error theta (3,) rad: every patch with its points moves in
    three dimensions.
    """
    p, row = update.patches, np.searchsorted(update.patches.key, update.points.patch)
    axes = np.stack([p.normal, p.tangent, np.cross(p.normal, p.tangent)], axis=1)
    shift = np.einsum("mkc,c,mki->mi", p.M_cal[:, [0, 3, 4], 1:4], theta, axes)[row]
    return dataclasses.replace(
        update, points=dataclasses.replace(update.points, r_map=update.points.r_map + shift)
    )


def test_a_simulated_boresight_error_common_to_both_epochs_leaves_the_difference_alone():
    theta = np.array([0.002, -0.003, 0.001])
    # a thousandth of the error breaks the ties among the diagonals of a regular grid
    updates = tuple(
        turned(u, 1e-3 * theta) for u in (surface_update(pit, spacing=0.25), surface_update(flat))
    )
    truth = epoch_difference(*(epoch(u) for u in updates))[0]
    both = [turned(u, theta) for u in updates]
    one = [both[0], updates[1]]
    common, single = (
        epoch_difference(*(epoch(u) for u in pair))[0].volume.volume_m3 - truth.volume.volume_m3
        for pair in (both, one)
    )
    assert abs(common) < 0.05 * abs(single)
    budget = {"boresight_sigma_deg": [math.degrees(abs(t)) for t in theta]}
    lines = epoch_difference(*(epoch(u, budget=budget) for u in updates))[0].budget.lines
    alone = epoch_difference(*(epoch(u, budget=budget) for u in updates), ("boresight",))[
        0
    ].budget.lines
    assert abs(common) < 3.0 * math.sqrt(lines["boresight"]) + 1e-3 * abs(single)
    assert abs(single) < 3.0 * math.sqrt(alone["boresight"])


def test_sigma_of_the_difference_against_sampling():
    rng = np.random.default_rng(11)
    budget = {
        "position_bias_fraction": 1.0,
        "position_white_fraction": 0.0,
        "lever_laser_sigma_m": [0.0, 0.0, 0.02],
    }
    updates = [
        surface_update(f, half=5.0, spacing=0.5, noise=0.05)
        for f in (lambda x, y: flat(x, y) - cone(x, y, 3.0), flat)
    ]
    epochs = [epoch(u, budget=budget) for u in updates]
    d, _ = epoch_difference(*epochs)
    quiet = {"lever_laser", "noise", "noise_previous", "position", "position_previous"}
    predicted = math.sqrt(sum(v for k, v in d.budget.lines.items() if k in quiet))
    net = []
    for _ in range(300):
        lever, surfaces = rng.normal(0.0, 0.02), []
        for u, e in zip(updates, epochs, strict=True):
            patches, row = u.patches, np.searchsorted(u.patches.key, u.points.patch)
            X = np.c_[np.ones(len(row)), u.points.local]
            sd = np.sqrt(np.diagonal(patches.cross, axis1=1, axis2=2))
            shift = (X * (sd * rng.standard_normal(sd.shape))[row]).sum(axis=1)
            shift += patches.normal[row] @ (
                np.array([0.0, 0.0, lever]) + rng.normal(0.0, 0.02, 3)
            )  # shared, and each survey's own
            order = np.lexsort(
                (u.points.r_map[:, 2], u.points.r_map[:, 1], u.points.r_map[:, 0], u.points.patch)
            )  # as the store keeps them
            move = (shift[:, None] * u.points.normal)[order][e.tin.source]
            surfaces.append(dataclasses.replace(e.tin, vertices=e.tin.vertices + move))
        net.append(volumes_between(*surfaces, gradients=False).net_m3)
    assert np.mean(net) == pytest.approx(d.volume.volume_m3, abs=4.0 * predicted / math.sqrt(300))
    assert np.std(net) == pytest.approx(
        predicted, rel=0.13
    )  # three standard errors of a sigma from 300 samples


def test_registration_enters_with_its_covariance():
    plain = epoch(surface_update(flat))
    tilt = Transform(
        exp_so3(np.array([0.0, 0.0, 0.4])),
        np.array([1.0, 2.0, 0.5]),
        np.zeros(3),
        1.0,
        np.diag([0, 0, 0, 0, 0, 1e-4, 0.0]),
    )
    turned = dataclasses.replace(
        plain.surface,
        tin=dataclasses.replace(
            plain.surface.tin, vertices=tilt.apply_inverse(plain.surface.tin.vertices)
        ),
    )
    away = dataclasses.replace(plain, surface=turned, transform=tilt)
    d, _ = epoch_difference(away, plain)
    assert abs(d.volume.volume_m3) < 1e-8
    assert d.budget.lines["registration"] == pytest.approx((0.01 * d.volume.area_m2) ** 2, rel=1e-6)
    assert "registration" not in epoch_difference(plain, plain)[0].budget.lines


def test_what_is_not_shared_is_correlated_through_what_is():
    rng = np.random.default_rng(0)
    A = rng.standard_normal((15, 15))
    C = A @ A.T
    shared = shared_columns(15, ())
    assert list(np.flatnonzero(~shared)) == [10]
    X = cross_covariance(C, C, shared)
    assert np.allclose(X[np.ix_(shared, shared)], C[np.ix_(shared, shared)])
    assert np.allclose(X[10, shared], C[10, shared]) and X[10, 10] < C[10, 10]
    joint = np.block([[C, X], [X.T, C]])
    assert np.linalg.eigvalsh(joint)[0] > -1e-9
    none = cross_covariance(C, C, shared_columns(15, CALIBRATION_GROUPS))
    assert not none.any()
    other = C.copy()
    other[1, 1] *= 1.1
    with pytest.raises(VolumeError) as caught:
        cross_covariance(C, other, shared)
    assert caught.value.reason == "epochs_calibration"
    assert calibration_groups(15)["clock"].tolist() == [10]


def test_a_correlated_calibration_is_one_line_that_cancels_too():
    triangle = [0.0] * 55
    triangle[10] = 0.6  # boresight_x with boresight_y
    triangle[13] = -0.5  # boresight_x with lever_laser_x
    budget = {"calibration_correlation": triangle}
    new, old = (epoch(surface_update(f), budget=budget) for f in (pit, flat))
    lines = epoch_difference(new, old)[0].budget
    assert "boresight" not in lines.lines and set(lines.within) == set(CALIBRATION_GROUPS)
    apart = epoch_difference(new, old, CALIBRATION_GROUPS)[0].budget
    assert lines.lines["calibration"] < 0.1 * apart.lines["calibration"]


def test_refusals():
    new, old = epoch(surface_update(pit)), epoch(surface_update(flat))
    for separate, reason in ((("bore",), "epochs_group"),):
        with pytest.raises(VolumeError) as caught:
            epoch_difference(new, old, separate)
        assert caught.value.reason == reason
    with pytest.raises(VolumeError) as caught:
        epoch_difference(
            new, epoch(surface_update(flat), budget={"boresight_sigma_deg": [1.0, 1.0, 1.0]})
        )
    assert caught.value.reason == "epochs_calibration"
    far = surface_update(flat)
    far = dataclasses.replace(
        far,
        points=dataclasses.replace(
            far.points, r_map=far.points.r_map + np.array([100.0, 0.0, 0.0])
        ),
    )
    with pytest.raises(VolumeError) as caught:
        epoch_difference(new, epoch(far))
    assert caught.value.reason == "volume_no_common_footprint"
    u = surface_update(flat)
    fewer = dataclasses.replace(
        u, patches=dataclasses.replace(u.patches, M_cal=u.patches.M_cal[:, :, :15])
    )
    with pytest.raises(VolumeError) as caught:
        epoch_difference(new, epoch(fewer))
    assert caught.value.reason == "epochs_sensor"
    assert epoch_difference(new, epoch(fewer), CALIBRATION_GROUPS)[0].volume.sigma_m3 > 0.0


def test_a_polygon_keeps_the_rest_out():
    new, old = epoch(surface_update(pit, spacing=0.25)), epoch(surface_update(flat))
    square = np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]])
    d = epoch_difference(new, old, polygon=square)[0]
    assert d.volume.area_m2 == pytest.approx(
        100.0, rel=0.05
    ) and d.volume.volume_m3 == pytest.approx(PIT, rel=1e-3)
    assert d.volume.sigma_m3 < epoch_difference(new, old)[0].volume.sigma_m3
    nothing = epoch_budget(
        new, old, np.zeros_like(new.tin.vertices), np.zeros_like(old.tin.vertices)
    )
    assert nothing.sigma == 0.0


def test_a_partial_tin_goes_through_its_adjustment():
    old = epoch(surface_update(flat))
    part = epoch(surface_update(pit, spacing=0.25), volume={"vertex_ratio": 0.4})
    whole = epoch(surface_update(pit, spacing=0.25))
    one, two = (epoch_difference(e, old)[0] for e in (part, whole))
    assert len(part.tin.vertices) < 0.5 * len(whole.tin.vertices)
    assert one.volume.volume_m3 == pytest.approx(PIT, rel=5e-3)
    assert one.volume.sigma_m3 / one.volume.area_m2 == pytest.approx(
        two.volume.sigma_m3 / two.volume.area_m2, rel=0.01
    )
    assert one.budget.lines["noise"] == pytest.approx(two.budget.lines["noise"], rel=0.2)


def unlike(update, seed):
    """The same survey with the noise of its patches drawn."""
    patches, rng = update.patches, np.random.default_rng(seed)
    row = np.searchsorted(patches.key, update.points.patch)
    deviation = np.sqrt(np.diagonal(patches.cross, axis1=1, axis2=2))
    drawn = (deviation * rng.standard_normal(deviation.shape))[row]
    return moved(update, (np.c_[np.ones(len(row)), update.points.local] * drawn).sum(axis=1))


@pytest.mark.parametrize("ratio", [1.0, 0.5])
def test_cut_and_fill_of_unchanged_ground_do_not_hang_on_where_it_lies(ratio):
    # the new survey reaches beyond the one before: heights out there are no differences
    out = []
    for slope, level in ((0.0, 0.0), (0.1, 50.0)):

        def ground(x, y, slope=slope, level=level):
            return level + slope * x

        new = epoch(
            unlike(surface_update(ground, half=6.0, noise=0.05), 1),
            navigation=False,
            volume={"vertex_ratio": ratio},
        )
        old = epoch(unlike(surface_update(ground, half=5.0, noise=0.05), 2), navigation=False)
        out.append(epoch_difference(new, old)[0])
    for d in out:
        v = d.volume
        assert v.cut_m3 - v.fill_m3 == pytest.approx(v.volume_m3, abs=1e-9)
        assert 0.0 < d.sigma_cut_m3 and abs(v.cut_m3) < 2.5 * d.sigma_cut_m3
        assert 0.0 < d.sigma_fill_m3 and abs(v.fill_m3) < 2.5 * d.sigma_fill_m3
        assert v.folded_m3 > 0.5 * (v.cut_m3 + v.folded_m3)
    assert out[0].sigma_cut_m3 == pytest.approx(out[1].sigma_cut_m3, rel=0.25)


def test_far_from_one_another_cut_has_the_sigma_of_the_net_volume_and_fill_none():
    new, old = epoch(surface_update(lambda x, y: flat(x, y) + 1.0)), epoch(surface_update(flat))
    d = epoch_difference(new, old)[0]
    assert d.sigma_cut_m3 == pytest.approx(d.volume.sigma_m3, rel=1e-6)
    assert d.volume.fill_m3 == 0.0 and d.sigma_fill_m3 < 1e-6 * d.sigma_cut_m3


def test_a_lift_that_both_share_leaves_both_cut_and_fill_uncertain():
    # one position error lifts all of a survey: of two equal surfaces either may lie above
    update = surface_update(flat, half=5.0, noise=1e-4)
    budget = {"position_bias_fraction": 1.0, "position_white_fraction": 0.0}
    new, old = (epoch(unlike(update, s), budget=budget) for s in (1, 2))
    d = epoch_difference(new, old)[0]
    # of max(X, 0) with X normal about zero the root mean square is sigma over the root of two
    for sigma in (d.sigma_cut_m3, d.sigma_fill_m3):
        assert sigma == pytest.approx(d.volume.sigma_m3 * math.sqrt(0.5), rel=0.15)

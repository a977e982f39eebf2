"""A surface that changed during the survey is found, and what moves all of a pass alike is not."""

import dataclasses
import math

import numpy as np
import pytest
from volume_surfaces import T0, normal_frame

from ladar_volume.model.records import Patches
from ladar_volume.volume.field_checks.surface_changes import common_offset, surface_change

BINS, SIDE, STEP_M, NOISE_M, BIN_NS = 10, 24, 0.5, 0.012, 1_000_000_000
FIRST = T0 // BIN_NS
#: A cone of 3 m within the square.
RADIUS_M = 3.0


def site(seed=0):
    """Patches every half metre of ground with a cone, seen in every bin."""
    rng, m = np.random.default_rng(seed), SIDE * SIDE
    x, y = (c.ravel() for c in np.meshgrid(*2 * [(np.arange(SIDE) - SIDE / 2 + 0.5) * STEP_M]))
    r = np.hypot(x, y)
    on = r < RADIUS_M
    centre = np.column_stack([x, y, np.where(on, 0.5 * (RADIUS_M - r), 0.0)])
    n = np.column_stack([np.where(on, 0.5 * x / r, 0.0), np.where(on, 0.5 * y / r, 0.0), r**0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    M_nav = np.zeros((m * BINS, 5, 4), np.float32)
    M_nav[:, -2, 0] = 1.0 / BINS
    each = NOISE_M / math.sqrt(100 / BINS)
    return Patches(
        np.arange(m),
        centre,
        n,
        normal_frame(n)[0],
        np.zeros((m, 3)),
        np.full(m, NOISE_M),
        np.full(m, 100, np.int32),
        np.full(m, T0),
        np.arange(m + 1),
        np.arange(m),
        np.zeros((m, 3, 3), np.float32),
        np.zeros((m, 5, 11), np.float32),
        BINS * np.arange(m + 1),
        np.tile(FIRST + np.arange(BINS), m),
        M_nav,
        nav_residual=rng.normal(0.0, each, m * BINS).astype(np.float32),
    )


def moved(made, rise):
    """The patches with rises (m, bins) m along their normals, about which they are fitted."""
    off = rise - rise.mean(axis=1, keepdims=True)
    return dataclasses.replace(
        made,
        sigma=np.sqrt(made.sigma**2 + (off**2).mean(axis=1)),
        nav_residual=made.nav_residual + off.ravel().astype(np.float32),
    )


def after(first):
    return (np.arange(BINS) >= first).astype(float)


@pytest.mark.parametrize(("first", "by_m"), [(3, 0.1), (5, -0.25), (8, 0.05)])
def test_what_was_heaped_on_or_taken_away_is_found_with_its_volume(first, by_m):
    made = site()
    top = np.hypot(*made.centre[:, :2].T) < 2.0
    found = surface_change(moved(made, by_m * top[:, None] * after(first)), BIN_NS)
    assert found.up == (by_m > 0.0)
    assert abs(found.t_ns / BIN_NS - FIRST - first) <= 1.0
    assert set(found.row) == set(np.flatnonzero(top))
    volume = float(found.area_m2 @ found.by_m)
    assert volume == pytest.approx(abs(by_m) * STEP_M**2 * top.sum(), rel=0.35)


def test_nothing_is_found_where_nothing_changed():
    made, n = site(), site().normal
    assert surface_change(made, BIN_NS) is None
    for rise in (
        (n @ [0.1, -0.05, 0.15])[:, None] * after(4),  # a jump of the positions
        (0.02 * made.centre[:, 0] * n[:, 2])[:, None] * after(4),  # a tilt of the attitude
        np.random.default_rng(1).normal(0.0, 0.03, (len(made), 1)) * after(4),  # rough ground
    ):
        assert surface_change(moved(made, rise), BIN_NS) is None
    few = (np.arange(len(made)) % 97 == 0)[:, None] * after(4)  # here and there, not together
    assert surface_change(moved(made, 0.2 * few), BIN_NS) is None


def test_patches_of_one_surface_belong_to_the_change_around_them():
    made = site()
    r = np.hypot(*made.centre[:, :2].T)
    ring, core = (r < 2.0) & (r > 1.2), r <= 1.2
    some = moved(made, 0.2 * ring[:, None] * after(5))
    weight = np.where(core[:, None], after(5) / after(5).sum(), 1.0 / BINS).ravel()
    M_nav = some.M_nav.copy()
    M_nav[:, -2, 0] = weight
    found = surface_change(dataclasses.replace(some, M_nav=M_nav), BIN_NS)
    assert set(np.flatnonzero(core)) <= set(found.row)
    assert found.by_m[np.isin(found.row, np.flatnonzero(core))] == pytest.approx(0.2, rel=0.2)


def test_residuals_that_are_not_known_tell_nothing():
    made = site()
    unknown = np.full(len(made) * BINS, np.nan, np.float32)
    assert surface_change(dataclasses.replace(made, nav_residual=unknown), BIN_NS) is None
    none = np.zeros(0, np.float32)
    assert surface_change(dataclasses.replace(made, nav_residual=none), BIN_NS) is None


def test_what_is_far_off_takes_no_part_in_the_fit():
    rng = np.random.default_rng(4)
    X = np.column_stack([np.ones(400), rng.uniform(-1.0, 1.0, 400)])
    y = X @ [0.3, -0.2] + rng.normal(0.0, 0.01, 400)
    y[:120] += 0.5
    left, scale = common_offset(X, y, np.ones(400))
    assert np.median(left[:120]) == pytest.approx(0.5, abs=0.005)
    assert abs(np.median(left[120:])) < 0.002 and scale < 0.02

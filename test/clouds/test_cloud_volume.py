"""Volumes of clouds: predicted against sampled standard deviations, the correction between two
surfaces, and what must cancel.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy import sparse

from ladar_volume.change.surface_difference import (
    along_curve,
    difference,
    difference_kernel,
    interpolation,
    mean_variance,
    variance_kernel,
    with_diagonal,
)
from ladar_volume.clouds.cloud_levels import above_floor, events, level_list, sequence
from ladar_volume.clouds.cloud_surface import cloud_surface, local_sigma
from ladar_volume.clouds.cloud_volume import (
    above_base,
    between_clouds,
    difference_of_footprints,
    has_selected_vertices,
)
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.tin.locate import height_at
from ladar_volume.tin.median_screen import edges
from ladar_volume.volume.near_base import csr

SIGMA = 0.05


def hill(xy):
    return 2.0 * np.exp(-(xy**2).sum(axis=1) / 8.0)


def footprint(n, seed, half=5.0):
    rng = np.random.default_rng(seed)
    return np.r_[
        half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), rng.uniform(-half, half, (n - 4, 2))
    ]


def noisy(xy, height, rng, sigma=SIGMA):
    return np.c_[xy, height(xy) + sigma * rng.normal(size=len(xy))]


def parameters(**volume):
    return Parameters.read({"volume": {"outline": "all", "base": "level", **volume}})


@pytest.mark.parametrize(
    "options,slack",
    [
        (SurfaceParameters(ratio=1.0), 0.3),
        (SurfaceParameters(ratio=1 / 3), 0.3),
        (SurfaceParameters(ratio=1 / 3, adjust="asd"), 0.3),
    ],
)
def test_sigmas_against_sampling(options, slack):
    xy, rng, rows = footprint(300, 0), np.random.default_rng(1), []
    for _ in range(40):
        v, _, _ = above_base(
            cloud_surface(noisy(xy, hill, rng), options, SIGMA), parameters(level_m=0.4)
        )
        rows.append([v.net_m3, v.cut_m3, v.fill_m3, v.sigma_m3, v.sigma_cut_m3, v.sigma_fill_m3])
    spread, predicted = np.std(rows, axis=0)[:3], np.sqrt(np.mean(np.square(rows), axis=0))[3:]
    # 40 samples: the standard error of a sigma is 11 %
    assert spread == pytest.approx(predicted, rel=slack)


@pytest.mark.parametrize("ratio", [1.0, 1 / 3])
def test_sigmas_between_two_surfaces_against_sampling(ratio):
    one, two, rng, rows = footprint(300, 2), footprint(250, 3), np.random.default_rng(4), []
    for _ in range(30):
        a = cloud_surface(noisy(one, hill, rng), SurfaceParameters(ratio=ratio), SIGMA)
        b = cloud_surface(
            noisy(two, lambda xy: 0.3 + 0 * xy[:, 0], rng), SurfaceParameters(ratio=ratio), SIGMA
        )
        v = between_clouds(a, b, "b")
        rows.append([v.net_m3, v.cut_m3, v.fill_m3, v.sigma_m3, v.sigma_cut_m3, v.sigma_fill_m3])
    spread, predicted = np.std(rows, axis=0)[:3], np.sqrt(np.mean(np.square(rows), axis=0))[3:]
    assert spread == pytest.approx(predicted, rel=0.35)


def test_unchanged_ground_between_two_epochs_is_neither_cut_nor_fill():
    one, two, rng, rows = footprint(1000, 5), footprint(1000, 6), np.random.default_rng(7), []
    for _ in range(8):
        a, b = (
            cloud_surface(
                noisy(xy, lambda p: 0.2 * p[:, 0], rng), SurfaceParameters(ratio=1.0), SIGMA
            )
            for xy in (one, two)
        )
        v = between_clouds(a, b, "b")
        rows.append([v.cut_raw_m3, v.cut_m3, v.fill_m3, v.net_m3, v.sigma_m3])
    raw, cut, fill, net, sigma = np.mean(rows, axis=0)
    # independent vertices on both sides: 0.28 sigma √2 per area on average
    assert raw == pytest.approx(0.28 * math.sqrt(2) * SIGMA * 100, rel=0.05)
    assert cut < 0.25 * raw and fill < 0.25 * raw and abs(net) < 4 * sigma / math.sqrt(8)


def test_no_noise_no_correction_and_unknown_noise_no_sigma():
    a = cloud_surface(
        np.c_[footprint(300, 8), hill(footprint(300, 8))], SurfaceParameters(ratio=1.0), 0.0
    )
    v, base, mask = above_base(a, parameters(level_m=0.5))
    assert (
        v.folded_m3 == 0.0
        and v.sigma_m3 == 0.0
        and v.cut_m3 == v.cut_raw_m3
        and len(base.support) == 0
        and mask.all()
    )
    few = cloud_surface(np.c_[footprint(20, 9), np.zeros(20)], SurfaceParameters(ratio=1.0))
    v, _, _ = above_base(few, parameters(level_m=0.0))
    assert (
        few.sigma_m is None
        and math.isnan(v.sigma_m3)
        and math.isnan(v.folded_m3)
        and math.isnan(v.budget_m6["noise"])
    )
    assert v.cut_m3 == v.fill_m3 == 0.0
    plain = above_base(
        dataclasses.replace(a, sigma_m=np.full(300, SIGMA)), parameters(level_m=0.5), correct=False
    )[0]
    assert plain.folded_m3 == 0.0 and plain.sigma_cut_m3 < plain.sigma_m3


def test_shift_identity_additivity_and_common_shift():
    rng = np.random.default_rng(10)
    a = cloud_surface(noisy(footprint(500, 11), hill, rng), SurfaceParameters(ratio=1.0), SIGMA)
    one, two = (above_base(a, parameters(level_m=z))[0] for z in (0.2, 0.9))
    assert one.net_m3 - two.net_m3 == pytest.approx(0.7 * one.area_m2, rel=1e-12)
    left, right = (
        above_base(a, parameters(level_m=0.2, outline="polygon", polygon_m=p))[0]
        for p in ([-5, -5, 1, -5, 1, 5, -5, 5], [1, -5, 5, -5, 5, 5, 1, 5])
    )
    assert left.net_m3 + right.net_m3 == pytest.approx(one.net_m3, abs=1e-9)
    assert left.area_m2 + right.area_m2 == pytest.approx(100.0)
    # raised by a metre with its own floor and ground the volume stays, and so does its sigma
    up = cloud_surface(a.points + np.array([0, 0, 1.0]), SurfaceParameters(ratio=1.0), SIGMA)
    found = [
        above_base(s, Parameters.read({"volume": {"object_height_m": 0.5}}))[0] for s in (a, up)
    ]
    assert found[0].net_m3 == pytest.approx(found[1].net_m3, rel=1e-9) and found[
        0
    ].sigma_m3 == pytest.approx(found[1].sigma_m3, rel=1e-6)
    assert found[0].budget_m6["base_surface"] > 0 and found[0].base_same_survey


def test_own_footprints_need_a_level():
    a = cloud_surface(np.c_[footprint(60, 12), np.zeros(60)], SurfaceParameters(ratio=1.0), SIGMA)
    with pytest.raises(VolumeError):
        difference_of_footprints(a, a, Parameters())
    both, one, two = difference_of_footprints(a, a, parameters(level_m=-1.0))
    assert (
        both.net_m3 == 0.0
        and one.net_m3 == two.net_m3 == pytest.approx(100.0)
        and both.sigma_m3 == pytest.approx(one.sigma_m3 * math.sqrt(2))
    )


@pytest.mark.parametrize("swap", [False, True])
def test_the_difference_surface_is_the_difference(swap):
    fine, coarse = (
        build_tin(np.c_[footprint(n, s), hill(footprint(n, s))]) for n, s in ((200, 13), (150, 14))
    )
    upper, lower = (coarse, fine) if swap else (fine, coarse)
    d, sign = difference(upper, lower), -1.0 if swap else 1.0
    assert d.upper_carries != swap and d.tin.relevant.all()
    own, other = fine.vertices[:, 2], coarse.vertices[:, 2]
    assert d.tin.vertices[:, 2] == pytest.approx(
        sign * (own - height_at(coarse, fine.vertices[:, :2])), abs=1e-12
    )
    Q = np.zeros((200, 150))
    np.add.at(Q, (np.arange(200)[:, None], d.corner), d.weight)
    assert d.tin.vertices[:, 2] == pytest.approx(sign * (own - Q @ other), abs=1e-12)
    rng = np.random.default_rng(21)
    A, B = (
        sparse.csr_array(sparse.diags(rng.uniform(0.5, 2, 200))) * 0.01,
        sparse.csr_array(np.diag(np.full(150, 0.04)) + 0.001),
    )
    joint, pattern = d.covariance(A, coarse, B), d.covariance(A, coarse, B).toarray() != 0
    plain = Q @ B.toarray() @ Q.T
    scale = mean_variance(coarse, B) / mean_variance(d.tin, sparse.csr_array(plain))
    assert joint.toarray() == pytest.approx(
        np.where(pattern, A.toarray() + scale * plain, 0.0), abs=1e-14
    )
    assert pattern.sum() == 200 + 2 * (200 + len(fine.triangles) - 1)  # vertices, and edges twice
    assert mean_variance(d.tin, joint) == pytest.approx(
        mean_variance(fine, A) + mean_variance(coarse, B), rel=1e-12
    )
    begin, column = with_diagonal(*edges(fine.triangles, fine.neighbours, 200))
    row = np.repeat(np.arange(200), np.diff(begin))
    value = difference_kernel(begin, column, csr(A), csr(B), d.corner, d.weight)
    for found, whole in zip(value, (A.toarray(), plain), strict=True):
        assert found == pytest.approx(whole[row, column], rel=1e-11, abs=1e-16)
    parts = variance_kernel(fine.vertices, fine.triangles, fine.relevant, *csr(joint))
    middle = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]])  # exact for quadratics
    t = fine.triangles[fine.relevant]
    C, area = joint.toarray()[t[:, :, None], t[:, None, :]], footprint_areas(fine.vertices, t)
    mean = np.einsum("ki,tij,kj->t", middle, C, middle) / 3.0
    assert parts.sum(axis=0) == pytest.approx([area @ mean, area.sum()], rel=1e-11)
    carried, rest = d.shares(np.full(200, 0.25), np.ones(200), 150)
    assert (
        (carried == 0.25).all()
        and rest[np.isfinite(rest)] == pytest.approx(0.25)
        and np.isfinite(rest).sum() > 100
    )
    assert interpolation(fine, np.array([[0.0, 0.0], [50.0, 0.0]]))[2].tolist() == [True, False]
    with pytest.raises(VolumeError):
        difference(
            upper, dataclasses.replace(lower, vertices=lower.vertices + np.array([100.0, 0, 0]))
        )


def test_numbers_along_a_curve_are_the_same_surface():
    tin = build_tin(np.c_[footprint(200, 22), hill(footprint(200, 22))])
    moved, order = along_curve(tin)
    assert np.array_equal(moved.vertices, tin.vertices[order]) and np.array_equal(
        moved.source, tin.source[order]
    )
    assert {tuple(np.roll(t, -np.argmin(t))) for t in order[moved.triangles]} == {
        tuple(np.roll(t, -np.argmin(t))) for t in tin.triangles
    }
    for t in range(len(moved.triangles)):
        for k in range(3):
            o = moved.neighbours[t, k]
            if o >= 0:
                assert set(np.delete(moved.triangles[t], k)) <= set(moved.triangles[o])
    assert (moved.neighbours < 0).sum() == (tin.neighbours < 0).sum()


def test_levels_and_floors():
    assert level_list(0, 1, 0.1).tolist() == pytest.approx(np.arange(11) / 10) and level_list(
        2, 2, 1
    ).tolist() == [2.0]
    for bad in (
        (0, 1, 0),
        (0, 1, -1),
        (1, 0, 0.1),
        (0, math.inf, 1),
        (0, 1, 1e-9),
        (math.nan, 1, 1),
    ):
        with pytest.raises(VolumeError):
            level_list(*bad)
    rng, rows = np.random.default_rng(15), []
    xy = footprint(600, 16)
    for _ in range(30):
        a = cloud_surface(
            noisy(xy, lambda p: np.where(np.abs(p).max(axis=1) < 2, 1.5, 0.0), rng, 0.02),
            SurfaceParameters(ratio=1.0),
            0.02,
        )
        found = sequence(a, level_list(-0.3, 1.8, 0.05))
        seen, sigma = events(a, found)
        v, p = above_floor(a, found, parameters())
        rows.append([seen[0].level_m, v.net_m3, sigma[0], v.sigma_m3, p.volume.level_m])
    spread, mean = np.std(rows, axis=0)[:2], np.mean(rows, axis=0)
    assert mean[0] == pytest.approx(0.0, abs=4 * mean[2] / math.sqrt(30) + 1e-3) and [
        r[4] for r in rows
    ] == [r[0] for r in rows]
    # the span of a spike is held fixed in the derivative; it follows the noise in truth
    assert spread == pytest.approx(mean[2:4], rel=0.4)
    assert events(a, sequence(a, level_list(0, 0.1, 0.05)))[0] == ()
    with pytest.raises(VolumeError):
        above_floor(a, sequence(a, level_list(50, 51, 0.1)), parameters())


@pytest.mark.parametrize("sigma", [0.003, 0.03])
def test_noise_from_local_quadrics(sigma):
    rng = np.random.default_rng(17)
    xy = footprint(3000, 18)
    quadric = 1 + 0.3 * xy[:, 0] - 0.2 * xy[:, 1] + 0.1 * xy[:, 0] ** 2 - 0.05 * xy[:, 0] * xy[:, 1]
    assert local_sigma(np.c_[xy, quadric]) < 1e-7
    assert local_sigma(np.c_[xy, quadric + sigma * rng.normal(size=3000)]) == pytest.approx(
        sigma, rel=0.05
    )
    spiked = quadric + sigma * rng.normal(size=3000)
    spiked[::100] += 5.0
    # a spike among a hundred points is in the neighbourhood of a sixth of them
    assert sigma < local_sigma(np.c_[xy, spiked]) < 1.4 * sigma
    screened = cloud_surface(np.c_[xy, spiked], SurfaceParameters(ratio=1.0), screen_m=2.0)
    assert screened.sigma_m[0] == pytest.approx(sigma, rel=0.05) and len(screened.outliers) >= 30
    # scan lines, and every footprint thrice
    lines = np.c_[xy[:, 0], np.round(xy[:, 1])]
    assert local_sigma(np.c_[lines, sigma * rng.normal(size=3000)]) == pytest.approx(
        sigma, rel=0.05
    )
    thrice = np.repeat(xy[:1000], 3, axis=0)
    assert local_sigma(np.c_[thrice, sigma * rng.normal(size=3000)]) == pytest.approx(
        sigma, rel=0.08
    )


def test_points_that_share_a_footprint_are_no_choice_of_vertices():
    rng = np.random.default_rng(12)
    xy = footprint(900, 12)
    r = noisy(np.r_[xy, xy[:40]], hill, rng)
    full = cloud_surface(r, SurfaceParameters(ratio=1.0))
    assert full.representation.tin.duplicates == 40 and not has_selected_vertices(full)
    assert has_selected_vertices(cloud_surface(r, SurfaceParameters(ratio=0.4)))

"""From a cloud to its surface: what the options do, where errors come from, and how a result goes
back to the points.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.adaptive import adaptive_tin
from ladar_volume.tin.delaunay import find_fault
from ladar_volume.tin.represent import represent, without_artificial
from ladar_volume.tin.scan_frame import frame_along


def cloud(n=600, seed=0, noise=0.02):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 10, (n, 2))
    return np.c_[xy, np.sin(xy[:, 0]) + noise * rng.normal(size=n)]


def test_without_artificial_corners_only_data_is_left():
    tin = adaptive_tin(cloud(), ratio=0.3).tin
    assert (tin.source < 0).sum() == 4
    small = without_artificial(tin)
    assert (
        (small.source >= 0).all()
        and len(small.triangles) == tin.relevant.sum()
        and small.relevant.all()
    )
    assert np.array_equal(small.vertices, tin.vertices[tin.source >= 0])
    assert np.array_equal(
        small.vertices[small.triangles], tin.vertices[tin.triangles[tin.relevant]]
    )
    t, k = np.nonzero(small.neighbours >= 0)
    o = small.neighbours[t, k]
    for a, edge, b in zip(t.tolist(), k.tolist(), o.tolist(), strict=True):
        shared = {small.triangles[a, (edge + 1) % 3], small.triangles[a, (edge + 2) % 3]}
        assert shared <= set(small.triangles[b].tolist()) and a in small.neighbours[b]
    assert without_artificial(small) is small


def test_full_surfaces_are_delaunay_and_unadjusted_ones_give_their_gradient_to_their_points():
    points = cloud()
    full = represent(points, SurfaceParameters(ratio=1.0))
    assert not find_fault(full.tin.vertices[:, :2], full.tin.triangles, full.tin.neighbours)
    assert full.fit is None and (full.rms_m, full.asd_m, full.fit_count) == (0.0, 0.0, 600)
    for options in (SurfaceParameters(ratio=1.0), SurfaceParameters(ratio=0.2, adjust="none")):
        made = represent(points, options)
        g = np.random.default_rng(1).normal(size=(len(made.tin.vertices), 2, 3))
        G = made.by_points(g, 600)
        assert np.array_equal(G[made.tin.source], g) and G.sum(axis=0) == pytest.approx(
            g.sum(axis=0)
        )
        sigma = np.random.default_rng(2).uniform(0.01, 0.1, 600)
        assert made.covariance(sigma).diagonal() == pytest.approx(sigma[made.tin.source] ** 2)


@pytest.mark.parametrize("weighted", [True, False])
def test_the_covariance_is_that_of_the_adjoint(weighted):
    points, sigma = (
        cloud(200),
        np.random.default_rng(3).uniform(0.01, 0.1, 200) if weighted else np.full(200, 0.05),
    )
    made = represent(points, SurfaceParameters(ratio=0.2), sigma if weighted else None)
    n = len(made.tin.vertices)
    unit = np.zeros((n, n, 3))
    unit[..., 2] = np.eye(n)
    S = made.by_points(unit, 200)[..., 2]
    full = (S * (sigma**2)[:, None]).T @ S
    C = made.covariance(sigma).toarray()
    assert np.diag(C) == pytest.approx(np.diag(full), rel=1e-7)
    t = made.tin.triangles
    assert C[t[:, 0], t[:, 1]] == pytest.approx(full[t[:, 0], t[:, 1]], rel=1e-6, abs=1e-12)


def test_exchanged_and_edited_surfaces_keep_their_area():
    points = cloud(noise=0.1)
    plain = represent(points, SurfaceParameters(ratio=0.1))
    better = represent(points, SurfaceParameters(ratio=0.1, exchange="rms"))
    assert (
        better.exchanges > 0
        and better.rms_m < plain.rms_m
        and len(better.tin.triangles) == len(plain.tin.triangles)
    )
    loose = represent(points, SurfaceParameters(ratio=0.1, adjust="rms-iterated", max_iterations=1))
    assert not loose.converged and plain.rms_m < loose.rms_m < loose.rms_before_m


def test_wrong_options():
    points = cloud(50)
    for wrong in (
        SurfaceParameters(adjust="best"),
        SurfaceParameters(exchange="best"),
        SurfaceParameters(relevant="none"),
        SurfaceParameters(vertices=5, ratio=0.5),
        SurfaceParameters(criterion="residual-sigma"),
        SurfaceParameters(ratio=0.0),
        SurfaceParameters(relevant="edge", max_edge_m=1e-9),
        SurfaceParameters(ratio=1.0, window=(50.0, 50.0, 60.0, 60.0)),
        SurfaceParameters(tolerance=-1.0),
    ):
        with pytest.raises(SurfaceError):
            represent(points, wrong)
    for bad in (points[:2], points[:, :2], np.where(points > 9, np.nan, points)):
        with pytest.raises(SurfaceError):
            represent(bad, SurfaceParameters(ratio=1.0))


def test_a_plane_in_a_turned_frame_holds_the_same_points():
    frame = dataclasses.replace(
        frame_along(np.array([0.3, -0.2, -1.0])), origin_map=np.array([5.0, 6.0, 7.0])
    )
    xy = cloud(20)[:, :2]
    turned = frame.points(np.c_[xy, 2.0 + 0.1 * xy[:, 0] - 0.3 * xy[:, 1]])
    c = frame.plane(np.array([2.0, 0.1, -0.3]))
    assert turned[:, 2] == pytest.approx(c[0] + turned[:, :2] @ c[1:], abs=1e-12)
    with pytest.raises(SurfaceError):
        frame_along(np.array([1.0, 0.0, 0.0])).plane(np.array([0.0, 0.0, 0.0]))


def test_diagonals_exchanged_last_leave_the_adjusted_heights():
    rng = np.random.default_rng(5)
    xy = rng.uniform(0.0, 4.0, (1500, 2))
    r = np.c_[xy, np.abs(xy[:, 0] + 0.4 * xy[:, 1] - 2.5) + 0.01 * rng.normal(size=1500)]
    sigma = np.full(len(r), 0.01)
    made = {
        (exchange, again): represent(
            r, SurfaceParameters(vertices=80, exchange=exchange, readjust=again), sigma
        )
        for exchange, again in (("none", True), ("asd", False), ("asd", True))
    }
    adjusted, last, again = made.values()
    assert last.exchanges > 0 and last.adjusted_on is not None
    assert np.array_equal(last.tin.vertices, adjusted.tin.vertices)
    assert again.rms_m < last.rms_m and last.asd_m < adjusted.asd_m
    # heights depend on the points as they did before the exchange, in plan too
    gradient = np.zeros((len(last.tin.vertices), 1, 3))
    gradient[:, 0, 2] = rng.normal(size=len(gradient))
    assert np.array_equal(last.by_points(gradient, len(r)), adjusted.by_points(gradient, len(r)))
    assert np.array_equal(last.covariance(sigma).diagonal(), adjusted.covariance(sigma).diagonal())

"""A surface through all points, some of which share a footprint: the mean heights, and what they
do to gradients and covariance, as from the fit to all points.
"""

import numpy as np
import pytest

from ladar_volume.model.records import F64
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.tin.adjustment_adjoint import height_covariance
from ladar_volume.tin.duplicates import places_and_rows
from ladar_volume.tin.elevation_adjustment import (
    adjust_rms,
    fit_of,
    fit_of_shared,
    measures,
    raw_gradient,
)
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.relevant import with_relevant
from ladar_volume.tin.represent import represent


def cloud(seed: int) -> tuple[F64, F64]:
    """Points (n, 3) m, of which some stand above others, and their sigmas (n,) m."""
    rng = np.random.default_rng(seed)
    xy = np.round(rng.uniform(0, 12, (500, 2)), 1)
    xy[450:] = xy[rng.integers(0, 450, 50)]
    return np.c_[xy, rng.normal(0, 1, 500)], rng.uniform(0.01, 0.05, 500)


@pytest.mark.parametrize("limit", [1.0, np.inf])
def test_points_that_are_alone_at_their_vertex_need_no_fit(limit: float) -> None:
    points, sigma = cloud(2)
    tin = with_relevant(build_tin(points), "edge", limit, np.inf)
    whole = fit_of(tin, points, sigma)
    fit, count = fit_of_shared(tin, points, sigma)
    assert count == len(whole.point) and 80 < len(fit.point) < 0.4 * count
    made, wanted = adjust_rms(tin, points, fit=fit).tin, adjust_rms(tin, points, fit=whole).tin
    assert np.array_equal(made.vertices, wanted.vertices)
    z = made.vertices[:, 2]
    assert measures(fit.residuals(z), count) == pytest.approx(measures(whole.residuals(z)))
    g = np.random.default_rng(0).normal(size=(len(z), 2))
    found, all_ = (raw_gradient(made, f, g, len(points)) for f in (fit, whole))
    assert found == pytest.approx(all_, rel=1e-12)
    own = sigma[tin.source] ** 2
    variance = [height_covariance(made, f, own).diagonal() for f in (fit, whole)]
    assert variance[0] == pytest.approx(variance[1], rel=1e-12)


def test_a_point_that_is_no_vertex_is_fitted_with_all() -> None:
    points, sigma = cloud(3)
    tin = build_tin(points[:400])
    fit, count = fit_of_shared(tin, points, sigma)
    whole = fit_of(tin, points, sigma)
    assert count == len(fit.point) == len(whole.point)
    assert (fit.B != whole.B).nnz == 0


def test_a_surface_of_points_with_one_footprint_each_has_measures_of_zero() -> None:
    points, sigma = cloud(4)
    made = represent(points, SurfaceParameters(ratio=1.0, relevant="all"), sigma)
    alone = represent(points[:20], SurfaceParameters(ratio=1.0, relevant="all"), sigma[:20])
    assert made.rms_m > 0.0 and made.fit_count == len(points)
    assert (alone.rms_m, alone.fit_count) == (0.0, 20)


def footprints(points: F64, rows: list[int]) -> list[list[float]]:
    """x, y, mean height, number of distinct heights, least row of each footprint, by hand."""
    heights: dict[tuple[float, float], set[float]] = {}
    first: dict[tuple[float, float], int] = {}
    for (x, y, z), row in zip(points.tolist(), rows, strict=True):
        heights.setdefault((x, y), set()).add(z)
        first[x, y] = min(row, first.get((x, y), row))
    return [[*at, sum(z) / len(z), len(z), first[at]] for at, z in sorted(heights.items())]


@pytest.mark.parametrize("kind", ["scattered", "ticks", "one line", "few", "none"])
def test_footprints_are_told_with_their_mean_height(kind: str) -> None:
    """Also where so many points share an x that they are sorted in another way."""
    rng = np.random.default_rng(3)
    n = {"few": 1, "none": 0}.get(kind, 900)
    points = rng.normal(size=(n, 3))
    if kind != "scattered":
        points = np.round(points, 1) + 0.0 * points  # with signed zeros
    if kind == "one line":
        points[:, 0] = 7.0
    rows = rng.permutation(2 * n)[:n]
    found, least = places_and_rows(points, rows)
    expected = footprints(points, rows.tolist())
    assert np.column_stack([found, least]) == pytest.approx(np.reshape(expected, (-1, 5)))
    assert not np.signbit(found[found == 0.0]).any()
    assert kind != "ticks" or (found[:, 3] > 1).any()

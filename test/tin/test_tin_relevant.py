"""TINs and the four choices of relevant triangles."""

from __future__ import annotations

import numpy as np
import pytest

from ladar_volume.model.errors import SurfaceError
from ladar_volume.tin.full_tin import build_tin, footprint_areas, vertex_mask
from ladar_volume.tin.relevant import (
    circumdiameters,
    edge_lengths,
    longest_sides,
    relevant_triangles,
    with_relevant,
)
from ladar_volume.volume.field_checks.terrace import mean_heights


def test_duplicates_are_reported_and_the_first_kept():
    points = np.array([[0, 0, 1.0], [2, 0, 2], [0, 2, 3], [2, 0, 99], [0, 0, 98]])
    tin = build_tin(points)
    assert tin.duplicates == 2 and tin.source.tolist() == [0, 1, 2]
    assert (
        tin.vertices[:, 2].tolist() == [1, 2, 3]
        and len(tin.triangles) == 1
        and tin.neighbours.tolist() == [[-1, -1, -1]]
    )


def test_areas_add_up_to_the_hull_and_are_counter_clockwise():
    points = np.random.default_rng(0).random((500, 3))
    points = np.concatenate([points, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]])
    tin = build_tin(points)
    area = footprint_areas(tin.vertices, tin.triangles)
    assert (area > 0).all() and area.sum() == pytest.approx(1.0, rel=1e-13)
    assert vertex_mask(tin, tin.relevant).all()


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((5, 3)),
        np.zeros((0, 3)),
        np.zeros((4, 2)),
        np.full((4, 3), np.nan),
        np.arange(12.0).reshape(4, 3),
    ],
)
def test_refusals(points):
    with pytest.raises(SurfaceError):
        build_tin(points)


def test_measures_of_a_right_triangle():
    tin = build_tin(np.array([[0, 0, 5.0], [3, 0, 7], [0, 4, 9]]))
    assert sorted(edge_lengths(tin)[0]) == pytest.approx([3, 4, 5])
    opposite = edge_lengths(tin)[0][tin.triangles[0] == 0]
    assert opposite == pytest.approx(5)
    assert circumdiameters(tin.vertices, tin.triangles) == pytest.approx([5])


def test_the_four_options():
    xy = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    corners = np.array([[-20.0, -20], [30, -20], [30, 30], [-20, 30]])
    tin = build_tin(np.concatenate([np.c_[xy, np.zeros(25)], np.c_[corners, np.zeros(4)]]))
    artificial = np.arange(25, 29)
    assert relevant_triangles(tin, "all").all()
    inner = relevant_triangles(tin, "corners", artificial=artificial)
    assert inner.sum() == 32 and not np.isin(tin.triangles[inner], artificial).any()
    assert relevant_triangles(tin, "edge", max_edge_m=1.5).sum() == 32
    assert not relevant_triangles(tin, "edge", max_edge_m=1.2).any()
    assert (
        relevant_triangles(
            tin, "circumcircle", max_circumdiameter_m=1.42, artificial=artificial
        ).sum()
        == 32
    )
    with pytest.raises(SurfaceError, match="no relevant triangle"):
        with_relevant(tin, "circumcircle", 9.0, 1.0)
    with pytest.raises(SurfaceError):
        relevant_triangles(tin, "some")


def test_longest_sides_and_mean_heights_are_those_of_the_corners():
    rng = np.random.default_rng(8)
    tin = build_tin(rng.random((60, 3)) * 10.0)
    rows = rng.permutation(len(tin.triangles))[:40]
    corner = tin.vertices[tin.triangles[rows]]
    sides = np.linalg.norm(corner[:, :, :2] - np.roll(corner, 1, axis=1)[:, :, :2], axis=2)
    found = longest_sides(tin.vertices, tin.triangles, rows)
    np.testing.assert_allclose(found, sides.max(axis=1), rtol=1e-14)
    mean = mean_heights(tin.vertices[:, 2].copy(), tin.triangles, rows)
    np.testing.assert_allclose(mean, corner[:, :, 2].mean(axis=1), rtol=1e-14)

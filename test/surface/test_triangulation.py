"""Insertion and removal: the triangulation is proved valid after every step, and equals one made
anew.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from ladar_volume.model.errors import SurfaceError
from ladar_volume.surface import removal
from ladar_volume.surface.delaunay import delaunay
from ladar_volume.surface.duplicates import first_within
from ladar_volume.surface.mesh import first_triangle, triangle_table
from ladar_volume.surface.predicates import workspace
from ladar_volume.surface.triangulation import Triangulation


def as_set(triangles):
    return {tuple(sorted(t)) for t in np.asarray(triangles).tolist()}


def same_as_anew(t):
    ids = np.flatnonzero(t.alive)
    return as_set(t.triangles()[0]) == as_set(ids[delaunay(t.xy[ids])[0]])


@pytest.mark.parametrize("window", [None, (-0.5, -0.2, 1.5, 1.3)])
def test_random_insertion_and_removal(window):
    rng = np.random.default_rng(0)
    t = Triangulation(rng.random((30, 2)), window)
    for _ in range(40):
        ids = t.insert(rng.random((rng.integers(0, 20), 2)))
        assert t.alive[ids].all() and t.fault() == ""
        living = np.flatnonzero(t.alive)[t.fixed :]
        t.remove(rng.choice(living, min(len(living) - 5, rng.integers(0, 20)), replace=False))
        assert t.is_valid() and same_as_anew(t)
    assert len(t.triangles()[0]) > 0 and (window is None or t.alive[:4].all())


@pytest.mark.parametrize("window", [None, (0.0, 0.0, 0.9, 0.9)])
def test_cocircular_grid_is_taken_apart_in_any_order(window):
    g = np.stack(np.meshgrid(np.arange(10.0), np.arange(10.0)), axis=-1).reshape(-1, 2) * 0.1
    for seed in range(3):
        rng = np.random.default_rng(seed)
        t = Triangulation(rng.permutation(g), window)
        assert t.is_valid() and t.alive.sum() == 100
        order = rng.permutation(np.flatnonzero(t.alive)[t.fixed :])
        removed = 0
        for v in order:
            try:
                t.remove(v)
            except SurfaceError as error:
                # on the way down to a last triangle some removals leave a line
                assert error.reason == "surface_collinear" and not t.fixed
                continue
            removed += 1
            assert t.fault() == ""
        assert t.alive.sum() == (4 if window else 3) and removed == (96 if window else 97)
        assert sum(t.exact_predicates) > 0


@pytest.mark.parametrize("kind", ["circle", "two lines", "fan", "nearly flat", "huge offset"])
def test_degenerate_sets_survive_removal_and_return(kind):
    rng = np.random.default_rng(1)
    a, s = np.arange(48) * (np.pi / 24), np.arange(25.0)
    xy = {
        "circle": np.concatenate([np.column_stack([np.cos(a), np.sin(a)]), [[0.0, 0.0]]]),
        "two lines": np.concatenate(
            [np.column_stack([s * 0.1, s * 0.3]), np.column_stack([s * 0.1 + 1.0, s * 0.3])]
        ),
        "fan": np.concatenate([np.column_stack([s, np.zeros(25)]), [[12.0, 5.0], [12.0, -4.0]]]),
        "nearly flat": rng.random((50, 2)) * [1.0, 1e-14],
        "huge offset": rng.integers(0, 6, (40, 2)) * 0.1 + [4.5e6, 5.4e6],
    }[kind]
    xy = np.unique(xy, axis=0)
    t = Triangulation(xy)
    assert t.fault() == ""
    for _ in range(60):
        v = rng.choice(np.flatnonzero(t.alive))
        try:
            t.remove([v])
            assert t.fault() == ""
            if rng.random() < 0.7:
                t.insert(t.xy[[v]])
        except SurfaceError as error:
            assert error.reason == "surface_collinear"
        assert t.fault() == ""


def test_a_vertex_with_a_thousand_neighbours():
    a = np.sort(np.random.default_rng(2).random(1000)) * 2.0 * np.pi
    t = Triangulation(
        np.concatenate(
            [np.column_stack([np.cos(a), np.sin(a)]) * (1.0 + 0.2 * a[:, None]), [[0.0, 0.0]]]
        )
    )
    t.remove(1000)
    assert t.fault() == "" and t.alive.sum() == 1000


def test_what_is_left_may_not_be_a_line():
    t = Triangulation(np.array([[0.0, 0], [1, 0], [2, 0], [3, 0], [1, 1]]))
    with pytest.raises(SurfaceError) as caught:
        t.remove([4])
    assert caught.value.reason == "surface_collinear" and t.is_valid() and t.alive.all()
    t.remove([1, 0])
    with pytest.raises(SurfaceError):
        t.remove(2)
    assert t.is_valid() and np.flatnonzero(t.alive).tolist() == [2, 3, 4]
    assert t.insert(np.array([[0.0, 0.0]])).tolist() == [5] and t.is_valid()


def test_points_within_the_tolerance_are_reported_and_stay_out():
    rng = np.random.default_rng(3)
    xy = rng.random((400, 2))
    t = Triangulation(xy, tolerance_m=0.05)
    kept = np.flatnonzero(t.alive)
    assert t.is_valid() and cKDTree(xy[kept]).query(xy[kept], k=2)[0][:, 1].min() > 0.05
    assert (
        np.array_equal(t.same, first_within(xy, 0.05))
        and np.array_equal(kept, np.unique(t.same))
        and np.linalg.norm(xy - xy[t.same], axis=1).max() <= 0.05
    )
    extra = rng.random((300, 2)) * 1.5
    ids = t.insert(extra)
    assert t.is_valid() and np.linalg.norm(extra - t.xy[ids], axis=1).max() <= 0.05
    kept = np.flatnonzero(t.alive)
    assert cKDTree(t.xy[kept]).query(t.xy[kept], k=2)[0][:, 1].min() > 0.05
    # each that stayed out lies at the vertex nearest to it then; all vertices of before are still
    # there
    assert t.insert(t.xy[kept]).tolist() == kept.tolist()


def test_exact_copies_and_signed_zeros():
    t = Triangulation(np.array([[0.0, 0], [2, 0], [0, 2], [-0.0, 0.0], [2, 0]]))
    assert t.same.tolist() == [0, 1, 2, 0, 1] and t.alive.sum() == 3
    assert t.insert(np.array([[0.0, -0.0], [5.0, 5.0]])).tolist() == [0, 6] and t.is_valid()


def test_a_map_and_its_points():
    t = Triangulation(window=(0.0, 0.0, 4.0, 2.0))
    assert t.is_valid() and len(t.triangles()[0]) == 2
    ids = t.insert(np.array([[4.0, 2.0], [1.0, 1.0], [2.0, 0.0], [0.0, 1.0]]))
    assert ids.tolist() == [2, 5, 6, 7] and t.is_valid()
    for points, reason in (
        (np.array([[5.0, 1.0]]), "surface_off_map"),
        (np.array([[np.nan, 1.0]]), "surface_not_finite"),
    ):
        with pytest.raises(SurfaceError) as caught:
            t.insert(points)
        assert caught.value.reason == reason
    for gone in ([0], [9], [-1], [5, 5], [4]):
        with pytest.raises(SurfaceError) as caught:
            t.remove(gone)
        assert caught.value.reason == "surface_vertex"
    t.remove([7, 6, 5])
    assert t.is_valid() and len(t.triangles()[0]) == 2
    assert t.insert(np.zeros((0, 2))).tolist() == []


def test_location():
    rng = np.random.default_rng(4)
    t = Triangulation(rng.random((100, 2)))
    q = rng.random((200, 2)) * 1.4 - 0.2
    for p, v in zip(q, t.locate(q), strict=True):
        triangles = t.triangles()[0]
        c = t.xy[triangles]
        d = np.roll(c, -1, axis=1) - c
        holds = (d[..., 0] * (p[1] - c[..., 1]) - d[..., 1] * (p[0] - c[..., 0]) >= 0).all(axis=1)
        assert (v[0] < 0) == (not holds.any()) and (
            v[0] < 0 or tuple(sorted(v)) in as_set(triangles[holds])
        )


@pytest.mark.parametrize(
    "options,reason",
    [
        ({}, "surface_too_few_points"),
        ({"xy": np.zeros((5, 2))}, "surface_too_few_points"),
        ({"xy": np.arange(8.0).reshape(4, 2)}, "surface_collinear"),
        ({"xy": np.zeros((4, 3))}, "surface_shape"),
        ({"xy": np.array([[0.0, np.inf]])}, "surface_not_finite"),
        ({"window": (0.0, 0.0, 0.0, 1.0)}, "surface_window"),
        ({"window": (0.0, 0.0, 1.0, 1.0), "tolerance_m": -1.0}, "surface_tolerance"),
        ({"window": (0.0, 0.0, 1.0, 1.0), "tolerance_m": 1.0}, "surface_window"),
    ],
)
def test_refusals(options, reason):
    with pytest.raises(SurfaceError) as caught:
        Triangulation(**options)
    assert caught.value.reason == reason


def test_compiled_kernels_equal_their_plain_twins(monkeypatch):
    rng = np.random.default_rng(5)
    xy = np.concatenate(
        [
            [[0.0, 0], [7, 0], [0, 7]],
            rng.integers(0, 7, (40, 2)).astype(float),
            rng.random((10, 2)) * 9.0,
        ]
    )
    names = [k for k, v in vars(removal).items() if hasattr(v, "py_func")]

    def run(square):
        w, m, same = workspace(), triangle_table(len(xy)), np.full(len(xy), -1)
        m[:] = 0
        first_triangle(xy, m, 0, 1, 2, w)
        same[:3] = 0, 1, 2
        order = np.arange(3, len(xy), dtype=np.int32)
        size, hint = removal.insert_within(xy, m, 4, 0, 0, order, square, same, w)
        gone = np.flatnonzero(same == np.arange(len(xy)))[::3]
        out = removal.remove_kernel(xy, m, size, hint, gone, w)
        return [same, np.array(out), m[: out[0]]]

    compiled = run(0.0), run(0.6)
    for name in names:
        monkeypatch.setattr(removal, name, getattr(removal, name).py_func)
    for a, b in zip(compiled, (run(0.0), run(0.6)), strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))

"""Given faces as a surface: closed forms, invariances, walls, overhangs, repairs and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V

from ladar_volume.clouds.given_faces import given_surface
from ladar_volume.clouds.mesh_surface import mesh_surface
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import SurfaceError
from ladar_volume.model.surface_parameters import SurfaceParameters
from ladar_volume.volume.prismoids import prismoids

UTM = np.array([21_530_269.076, 6_782_635.184, 0.0])
#: A pyramid of 4 x 4 m, 3 m high, without its base.
PYRAMID_V = np.array([[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [2, 2, 3.0]])
PYRAMID_T = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
#: An L of three squares of 2 m: its hull has half a square more.
L_V = np.array([[x, y, 1.0] for y in (0, 2, 4) for x in (0, 2, 4)], float)
L_T = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6]], np.int32)
#: A terrace: a floor at 0, a wall on end at x = 1, a bench at 1.
STEP_V = np.array([[x, y, z] for x, z in ((0, 0), (1, 0), (1, 1), (2, 1)) for y in (0, 1)], float)
STEP_T = np.array([[0, 2, 3], [0, 3, 1], [2, 4, 5], [2, 5, 3], [4, 6, 7], [4, 7, 5]], np.int32)


def volume(v, t, level, **more):
    found = prismoids(mesh_surface(v, t, **more).representation.tin, design_surface([level]))
    return found.cut_m3, found.fill_m3, found.area_m2


def turned(v, angle=0.7, at=UTM):
    c, s = math.cos(angle), math.sin(angle)
    return v @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T + at


@pytest.mark.parametrize("level,above", [(0.0, 16.0), (1.0, 16.0 * (2 / 3) ** 3), (3.0, 0.0)])
def test_a_pyramid_above_a_level(level, above):
    below = 16.0 * level - (16.0 - above)
    for v in (PYRAMID_V, turned(PYRAMID_V), turned(PYRAMID_V, -2.0, UTM + np.array([0.1, 0.2, 0]))):
        # 2e7 m hold their last digit to 4e-9 m
        assert volume(v, PYRAMID_T, level) == pytest.approx((above, below, 16.0), abs=1e-6)


def test_the_hull_does_not_count():
    assert volume(L_V, L_T, 0.0) == pytest.approx((12.0, 0.0, 12.0))
    holed = L_T[[0, 1, 2, 5]]
    assert volume(L_V, holed, 0.0)[2] == pytest.approx(8.0)


def test_orientation_makes_no_difference():
    rng = np.random.default_rng(0)
    for _ in range(5):
        t = L_T.copy()
        flip = rng.random(len(t)) < 0.5
        t[flip] = t[flip][:, ::-1]
        t = np.stack(
            [np.roll(row, k) for row, k in zip(t, rng.integers(0, 3, len(t)), strict=True)]
        )
        assert volume(L_V, t[rng.permutation(len(t))], 0.5) == pytest.approx((6.0, 0.0, 12.0))
    assert (
        given_surface(L_V, L_T[:, ::-1]).clockwise_faces == 0
    )  # all the other way round: none is odd
    odd = L_T.copy()
    odd[2] = odd[2][::-1]
    assert given_surface(L_V, odd).clockwise_faces == 1


def test_a_wall_on_end_has_no_volume():
    for v in (STEP_V, turned(STEP_V), turned(STEP_V, 1.1)):
        found = given_surface(v, STEP_T)
        assert (found.vertical, len(found.tin.triangles), found.parts) == (2, 4, 2)
        assert volume(v, STEP_T, 0.25) == pytest.approx((0.75, 0.25, 2.0), abs=1e-6)
    with pytest.raises(SurfaceError, match="stand on end") as error:
        given_surface(STEP_V, STEP_T[2:4])
    assert error.value.reason == "surface_vertical"


def test_an_overhang_is_refused_with_its_area():
    v = STEP_V.copy()
    v[4:6, 0] -= 0.3  # the bench overhangs the floor by 0.3 x 1 m
    for r in (v, turned(v)):
        with pytest.raises(SurfaceError, match="lie under a second face") as error:
            given_surface(r, STEP_T)
        # the bench over the floor, and the leaning wall over and under both
        assert error.value.reason == "surface_overlap" and error.value.value >= 0.3 - 1e-9


def test_two_sheets_over_one_another_are_refused():
    v = np.concatenate([L_V, L_V + np.array([0.5, 0.5, 1.0])])
    with pytest.raises(SurfaceError, match="lie under a second face"):
        given_surface(v, np.concatenate([L_T, L_T + 9]))
    apart = np.concatenate([L_V, L_V + np.array([10.0, 0.5, 1.0])])
    assert given_surface(apart, np.concatenate([L_T, L_T + 9])).parts == 2


def test_a_sliver_that_rounding_folded_over_is_a_doubt():
    n = 60
    g = np.arange(n + 1.0)
    v = np.array([[x, y, 1.0] for x in g for y in g])
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (s.ravel() for s in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    t = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    v[k[30, 30], 0] += 1.01  # 1 cm beyond its neighbour
    surface = mesh_surface(v, t)
    (doubt,) = surface.doubts
    assert doubt.name == "surface_overlap" and 0.0 < doubt.value < 0.05 and "m²" in doubt.text
    clean = mesh_surface(
        v - np.where(np.arange(len(v)) == k[30, 30], 1.01, 0.0)[:, None] * [1, 0, 0], t
    )
    assert clean.doubts == ()


def test_a_body_is_sent_to_its_own_verb():
    with pytest.raises(SurfaceError, match="ladar_volume body") as error:
        given_surface(CUBE_V, CUBE_T.astype(np.int32))
    assert error.value.reason == "surface_closed"


def test_vertices_in_no_face_are_not_there():
    v = np.concatenate([[[1e6, -1e6, 5.0]], L_V, [[50.0, 60.0, 7.0]]])
    found = given_surface(v, L_T + 1)
    assert found.unused_vertices == 3 and volume(v, L_T + 1, 0.0) == pytest.approx(
        (12.0, 0.0, 12.0)
    )
    assert found.index.tolist() == [1, 2, 3, 4, 5, 6, 7, 8]


def test_a_mesh_has_no_sigma_of_its_own():
    surface = mesh_surface(PYRAMID_V, PYRAMID_T)
    assert surface.sigma_m is None and "no noise of its own" in surface.sigma_from
    given = mesh_surface(PYRAMID_V, PYRAMID_T, sigma_m=0.01)
    gradient = prismoids(given.representation.tin, design_surface([0.0])).gradient_net[:, 2:]
    # each corner carries 8/3 m², the top 16/3 m²
    assert given.variance(gradient)[0] == pytest.approx(
        1e-4 * (4 * (8 / 3) ** 2 + (16 / 3) ** 2), rel=1e-12
    )


def test_neighbours_lie_across_the_edge_opposite_their_corner():
    tin = given_surface(L_V, L_T).tin
    for t, row in enumerate(tin.neighbours):
        for k, o in enumerate(row):
            edge = {tin.triangles[t, (k + 1) % 3], tin.triangles[t, (k + 2) % 3]}
            beside = [
                u for u in range(len(tin.triangles)) if u != t and edge <= set(tin.triangles[u])
            ]
            assert beside == ([] if o < 0 else [o])


def test_thinning_keeps_the_footprint_and_says_what_it_costs():
    n = 20
    g = np.linspace(0, 10, n + 1)
    v = np.array([[x, y, math.sin(x) * math.cos(y)] for x in g for y in g])
    k = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (s.ravel() for s in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
    t = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]).astype(np.int32)
    t = t[~((v[t][:, :, :2] > 4.9).all(axis=(1, 2)))]  # an L again
    full = volume(v, t, -2.0)
    surface = mesh_surface(v, t, SurfaceParameters(ratio=0.5), thin=True)
    found = prismoids(surface.representation.tin, design_surface([-2.0]))
    (doubt,) = surface.doubts
    assert doubt.name == "mesh_thinned" and len(surface.representation.tin.vertices) < 0.6 * len(v)
    assert found.area_m2 == pytest.approx(full[2], rel=0.05) and full[2] == pytest.approx(75.0)
    assert found.cut_m3 - full[0] == pytest.approx(0.0, abs=0.06 * full[0])

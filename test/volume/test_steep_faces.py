"""The line ``edges``: what is not known of where steep faces lie."""

import math

import numpy as np
import pytest

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Tin
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.base import ZERO
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.field_checks.steep_faces import (
    edge_doubts,
    enclosed_m3,
    faces_to_base,
    steep_faces,
)
from test.scenes.cone_pile import estimated, names, pile
from test.scenes.surveyed_box import states, survey_of_a_box

LONG, BOX_M3 = 2.0, 2.0 * 1.5 * 1.2


def face(profile):
    """A face along y through a profile of (x, z), and the footprints of its triangles."""
    vertices = np.array([(x, y, z) for x, z in profile for y in (0.0, LONG)])
    two = np.array([[0, 2, 1], [1, 2, 3]], np.int32)
    triangles = np.concatenate([two + np.int32(2 * k) for k in range(len(profile) - 1)])
    n = len(triangles)
    a, b, c = vertices[triangles].swapaxes(0, 1)
    flat = 0.5 * np.cross(b - a, c - a)[:, 2]
    assert (flat > 0.0).all()
    none = np.full((n, 3), -1, np.int32)
    return Tin(vertices, triangles, none, np.ones(n, bool), np.arange(len(vertices))), flat


def told(profile, steep=False, share=1.0):
    tin, flat = face(profile)
    return steep_faces(tin, share * flat, np.full(len(tin.vertices), steep))


@pytest.mark.parametrize(("wide", "high"), [(0.06, 1.2), (0.2, 0.5), (0.01, 3.0)])
def test_a_face_may_stand_anywhere_between_its_upper_and_lower_points(wide, high):
    found = told([(-1.0, high), (0.0, high), (wide, 0.0), (1.0, 0.0)])
    # two triangles: a half alike, all of either's own range
    share = math.sqrt(0.5**2 + 2 * 0.5**2)
    assert found.sigma_m3 == pytest.approx(share * LONG * high * wide / math.sqrt(12.0))
    assert found.apart_m == pytest.approx(wide)
    assert (found.x_m, found.y_m) == pytest.approx((wide / 2.0, LONG / 2.0))
    half = told([(-1.0, high), (0.0, high), (wide, 0.0), (1.0, 0.0)], share=0.5)
    assert half.sigma_m3 == pytest.approx(0.5 * found.sigma_m3)


def test_points_on_a_face_tell_where_it_is():
    heights = np.linspace(1.2, 0.0, 5)
    seen = told([*zip(np.linspace(0.0, 0.08, 5), heights, strict=True)])
    bare = told([(0.0, 1.2), (0.08, 0.0)])
    alike = math.sqrt((0.5**2 + 1 / 8) / (0.5**2 + 1 / 2))
    assert seen.sigma_m3 == pytest.approx(alike * bare.sigma_m3 / 4.0)
    assert seen.apart_m == pytest.approx(0.02)


def test_slopes_of_loose_material_and_their_noise_have_no_such_line():
    assert told([(0.0, 2.0), (2.0, 0.0)]) is None
    rough = [(0.0, 0.30), (0.1, 0.20), (0.15, 0.12), (0.25, 0.05)]
    assert told(rough) is None and told(rough, steep=True) is not None
    heap = estimated(lambda x, y: pile(x, y, top=4.0))
    assert heap.volume.verdict.sound and "edges" not in heap.volume.budget_m6


def test_the_doubt_tells_the_length_and_what_to_do():
    found = told([(0.0, 1.2), (0.06, 0.0)])
    (doubt,) = edge_doubts(found, 3.6, 0.3 * found.sigma_m3)
    assert "6 cm" in doubt.text and "volume.kind to bodies" in doubt.text
    assert doubt.value == pytest.approx(0.06)
    assert not edge_doubts(found, 3.6, 0.4 * found.sigma_m3)
    assert not edge_doubts(found, 210.0 * found.sigma_m3, 0.0)


def surveyed(kind, seed):
    p = Parameters.read({"filter": {"radius_m": 0.15}, "volume": {"kind": kind}})
    surface, estimator = SurfaceFilter(p), VolumeEstimator(p)
    for stage in (surface, estimator):
        stage.add_platform(states())
    surface.add(survey_of_a_box(seed))
    estimator.add(surface.finish())
    return estimator


def test_a_surveyed_box_is_in_its_sigma_and_named():
    estimator = surveyed("surface", 5)
    found = estimator.estimate()
    v = found.volume
    rest = v.sigma_m3**2 - v.budget_m6["edges"]
    error = abs(v.volume_m3 - BOX_M3)
    assert 5.0 * math.sqrt(rest) < error < 2.0 * v.sigma_m3 and v.sigma_m3 < 0.06 * BOX_M3
    assert "edges" in names(found)
    estimator.set_parameters(Parameters.read({"volume": {"kind": "bodies"}}))
    closed = estimator.estimate()
    assert "edges" not in names(closed) and "edges" in closed.volume.budget_m6


def enclosed(rise, faces, half=10.0):
    """What faces enclose on a grid of 25 cm that rises by a function of its places."""
    side = np.arange(-half, half + 0.1, 0.25)
    x, y = (c.ravel() for c in np.meshgrid(side, side))
    tin = build_tin(np.column_stack([x, y, rise(x, y)]))
    p = tin.vertices
    area = np.full(len(tin.triangles), 0.25**2 / 2.0)
    return enclosed_m3(tin, area, faces(p[:, 0], p[:, 1]))


def block(x, y):
    return (np.abs(x - 2.0) < 1.51) & (np.abs(y + 1.0) < 3.01)


def rim(x, y):
    return block(x, y) & ((np.abs(x - 2.0) > 1.4) | (np.abs(y + 1.0) > 2.9))


def test_what_faces_enclose_is_its_top_times_its_height_also_on_a_slope():
    for slope in (0.0, 0.4):
        found = enclosed(lambda x, y, k=slope: k * x + 2.0 * block(x, y), rim)
        assert found == pytest.approx(2.0 * 3.0 * 6.0, rel=0.03)


def test_a_terrace_and_a_bay_enclose_nothing():
    assert enclosed(lambda x, y: 2.0 * (x > 1.0), lambda x, y: np.abs(x - 1.25) < 0.01) == 0.0
    cone = np.vectorize(lambda x, y: max(3.0 - 0.5 * math.hypot(x, y), 0.0))
    assert enclosed(cone, lambda x, y: np.maximum(np.abs(x), np.abs(y)) > 8.9) == 0.0
    assert enclosed(lambda x, y: 2.0 * block(x, y), lambda x, y: x > 1e9) == 0.0


def test_noise_on_slivers_between_scan_lines_is_no_face():
    """A slope of 30°, lines a metre apart, returns of 12 mm of noise every 2 cm; then a face."""
    rng = np.random.default_rng(5)
    x, y = (c.ravel() for c in np.meshgrid(np.arange(0.0, 8.0), np.arange(0.0, 6.0, 0.02)))
    y = y + rng.uniform(-0.009, 0.009, len(y))
    slope = build_tin(np.column_stack([x, y, 0.58 * x + rng.normal(0.0, 0.012, len(x))]))
    every = np.ones(len(slope.triangles), bool)
    assert len(faces_to_base(slope, ZERO, every, 10.0)) == 0
    step = build_tin(np.column_stack([x, y, 1.5 * (y > 3.0) + rng.normal(0.0, 0.012, len(x))]))
    found = faces_to_base(step, ZERO, np.ones(len(step.triangles), bool), 10.0)
    assert len(found) > 20 and np.abs(found[:, 1] - 3.0).max() < 0.1

"""The published procedure against its brute-force twin: rays through Qhull's triangles."""

from __future__ import annotations

import numpy as np
import pytest
from nist_rays import Surface, cut_difference, fill_difference

from ladar_volume.experiments.nist import nist_experiments as e
from ladar_volume.experiments.nist.nist_scene import pair
from ladar_volume.volume.overlay import volumes_between

#: Coordinates are not rounded here: on a lattice of millimetres many points are co-circular, and
#: two valid triangulations differ.
STEP_M = 0.01


def vertices_of(points, count):
    """The vertices that adaptive insertion chose, as given: which they are is common to both."""
    source = e.adaptive(points, count).tin.source
    return points[source[source >= 0]]


@pytest.mark.parametrize("rms", [False, True])
def test_experiment_three_against_rays(rms):
    seed = 1
    a, b = pair(1, seed, 0.02, 0.0)
    points = a.points[e.subsets(a, seed, 0)[0]], b.points[e.subsets(b, seed, 1)[0]]
    own = e.method_two(*e.surface_pairs(points, (3000, 3000))[rms])
    rays, error = cut_difference(
        [vertices_of(p, 3000) for p in points],
        points,
        own.level_with_m[0],
        rms,
        STEP_M,
        np.random.default_rng(seed),
    )
    assert error < 0.002 and abs(own.volume_m3[0] - rays) < 4.0 * error


@pytest.mark.parametrize("rms", [False, True])
def test_experiment_four_against_rays(rms):
    a, b = pair(1, 2, 0.02, 0.0)
    frame = e.scan_frame(b)
    points = (
        frame.points(a.points[e.subsets(a, 2, 0)[0]]),
        frame.points(b.points[e.subsets(b, 2, 1)[0]]),
    )
    own = e.compare_methods(e.surface_pairs(points, (3000, 3000))[rms])
    vertices, rng = [vertices_of(p, 3000) for p in points], np.random.default_rng(5)
    for pairs, difference in ((own.one, fill_difference), (own.two, cut_difference)):
        rays, error = difference(vertices, points, pairs.level_with_m[-1], rms, STEP_M, rng)
        assert error < 0.001 and abs(pairs.volume_m3[-1] - rays) < 4.0 * error


def test_the_common_footprint_against_rays():
    a, b = pair(4, 1, 0.02, 0.0)
    frame = e.scan_frame(b)
    turned = [frame.points(s.points) for s in (a, b)]
    r = volumes_between(*(e.adaptive(p, len(p)).tin for p in turned), gradients=False)
    surfaces = [Surface(p, p, False) for p in turned]
    rng = np.random.default_rng(0)
    d = [
        np.nan_to_num(surfaces[0].heights(xy) - surfaces[1].heights(xy), nan=0.0)
        for xy in surfaces[0].rays(STEP_M, rng)
    ]
    value, error = (
        STEP_M**2 * np.mean(d, axis=0).sum(),
        0.5 * STEP_M**2 * np.sqrt(((d[0] - d[1]) ** 2).sum()),
    )
    assert error < 5e-4 and abs(r.net_m3 - value) < 4.0 * error

"""Cells that find no surface look more closely."""

import numpy as np

from benchmarks.bodies import CASES, cloud
from ladar_volume.clouds.filter import cell_surface
from ladar_volume.clouds.filter.cell_cover import Regions, project_on_cells
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.model.parameters import FilterParameters


def test_a_cell_without_a_surface_takes_a_smaller_radius():
    """A ball of 0.3 m within neighbourhoods of 0.8 m is no quadric and no set of planes."""
    rng = np.random.default_rng(2)
    n = rng.normal(size=(3000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    r = n * (0.3 + rng.normal(0.0, 0.005, (3000, 1)))
    balls, sigma, top = (
        0.8 * 2.0 ** np.array([-2.0, -1.5, -1.0, -0.5, 0.0]),
        np.full(3000, 0.005),
        np.full(3000, 4),
    )
    for least, kept in ((top, 0.0), (0 * top, 0.98)):
        done = project_on_cells(
            r, Regions(balls, top, least, sigma, 3.0 * sigma), FilterParameters(), 2
        )
        good = done.reason == cell_surface.KEPT
        assert good.mean() >= kept and (done.level[good] < 4).all()
        assert np.abs(np.linalg.norm(done.q[good], axis=1) - 0.3).max(initial=0.0) < 0.01
    assert (done.reason == cell_surface.NO_SURFACE).sum() == 0


def test_no_part_of_a_mushroom_is_left_out():
    """Where the stem bends away on both sides within the radius that suits the cap, a smaller one
    does.
    """
    case = CASES["mushroom"]
    f = filter_cloud(cloud(case, 0), FilterParameters(), auto=True)
    assert f.report["no_surface"] == 0 and f.report["kept"] > 0.995 * 8000
    assert len(f.reach) == len(f.r) and np.ptp(f.reach) > 0.0

"""The mounting that a recording's configuration gives, held against its own sweeps: what stands on
the ground lies on itself from sweep to sweep, and takes less space than with any other mounting.
"""

from pathlib import Path

import numpy as np
import pytest

from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.replay import Replay

BAG = Path(__file__).parents[2] / "bags" / "leo_cut"
YAW = "calibration.boresight_yaw_deg"


def occupied(*overrides):
    """Voxels of 0.2 m that hold what stands 0.6 to 4 m above the median of all returns."""
    region = "georeference.region_m=[-40,-40,-5,40,40,12]"
    parameters = read_config(BAG / "config.yaml", [region, *overrides])
    with BagReader(BAG) as bag:
        replay = Replay(bag, parameters, bag.roles())
        stage = Georeferencer(replay.parameters)
        add = {"fix": stage.add_fix, "imu": stage.add_imu, "cloud": stage.add_returns}
        for _, role, record in replay.records():
            if role in add:
                add[role](record)
    stage.finish()
    stage.take_platform()
    r_map = np.vstack([points.r_map for points in stage.take_points()])
    above = r_map[:, 2] - np.median(r_map[:, 2])
    standing = r_map[(above > 0.6) & (above < 4.0)]
    return len(np.unique(np.floor(standing / 0.2), axis=0))


@pytest.fixture(scope="module")
def as_given():
    return occupied()


@pytest.mark.parametrize("turned", [0.0, 90.0, 270.0])
def test_no_other_heading_of_the_scanner_fits_better(as_given, turned):
    assert as_given < 0.6 * occupied(f"{YAW}={turned}")


@pytest.mark.parametrize("turned", [175.0, 186.0])
def test_a_few_degrees_are_seen(as_given, turned):
    assert as_given < 0.97 * occupied(f"{YAW}={turned}")

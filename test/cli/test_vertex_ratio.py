"""A bundled recording with a third of its filtered points as vertices: the same volume within
sigma, the truth within the interval.
"""

import dataclasses
import json
from pathlib import Path

import pytest

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.replay import Replay

BAG = Path(__file__).parents[2] / "bags" / "box"


def test_a_third_of_the_vertices_on_the_bundled_recording():
    parameters = read_config(BAG / "config.yaml", [])
    with BagReader(BAG) as bag:
        replay = Replay(bag, parameters, bag.roles(), duration_s=18.0)
        full = replay.run()
    one_third = dataclasses.replace(
        parameters, volume=dataclasses.replace(parameters.volume, vertex_ratio=1 / 3)
    )
    replay.engine.estimator.set_parameters(one_third)
    part = replay.engine.estimator.estimate()
    assert len(part.tin.vertices) == pytest.approx(len(full.tin.vertices) / 3, rel=0.01)
    assert abs(part.volume.volume_m3 - full.volume.volume_m3) < full.volume.sigma_m3
    low, high = part.volume.interval_m3
    assert low <= json.loads((BAG / "truth.json").read_text())["volume_m3"] <= high
    # and back: the surface of the full ratio again, to the last bit
    replay.engine.estimator.set_parameters(parameters)
    again = replay.engine.estimator.estimate()
    assert (
        again.volume.volume_m3 == full.volume.volume_m3
        and again.tin.vertices.tobytes() == full.tin.vertices.tobytes()
    )

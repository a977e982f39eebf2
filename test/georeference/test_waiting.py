"""Returns that wait for poses are bounded, and what is lost is counted."""

import numpy as np

from ladar_volume.georeference import georeferencer
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Returns


def test_a_clock_that_stands_still_fills_no_memory(monkeypatch):
    monkeypatch.setattr(georeferencer, "MOST_WAITING", 1000)
    stage = georeferencer.Georeferencer(Parameters())
    t = np.full(100, 10**12, np.int64)
    r = np.tile([5.0, 1.0, 0.0], (100, 1))
    for _ in range(50):
        stage.add_returns(Returns(t, r, np.zeros(100, np.uint16), np.full(100, 9.0, np.float32)))
    assert stage.pending <= 1000
    stage.finish()
    assert sum(stage.losses.as_dict().values()) == 5000
    assert stage.losses.as_dict()["point_waiting_full"] > 0

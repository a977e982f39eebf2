"""Bodies above a base: what rises, and what is said where only a pit lies below."""

import numpy as np
import pytest

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.model.errors import VolumeError
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.outline import labelled_bodies


def test_a_pit_is_no_body_and_is_named():
    xy = np.random.default_rng(2).uniform(-10.0, 10.0, (3000, 2))
    away = np.hypot(xy[:, 0] - 3.0, xy[:, 1] + 2.0)
    tin = build_tin(np.c_[xy, -np.maximum(0.0, 2.0 - 0.5 * away)])
    level = design_surface([0.0])
    with pytest.raises(VolumeError, match=r"a pit of 3\d\.\d m² is up to 1\.9\d m deep") as error:
        labelled_bodies(tin, level, 0.15)
    assert "about (3.0, -2.0) m" in str(error.value) and "\n" not in str(error.value)
    flat = build_tin(np.c_[xy, np.zeros(len(xy))])
    with pytest.raises(VolumeError, match=r"above the base$"):
        labelled_bodies(flat, level, 0.15)

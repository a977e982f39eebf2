"""Small scenes for the filter: a platform on a straight, turning path and mapped points below
it.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from mapped_sheet import SECOND, mapped, platform, sheet

from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import MappedPoints
from ladar_volume.rmls.surface_filter import SurfaceFilter


def filtered(points, batches=1, states=None, **settings):
    f = SurfaceFilter(Parameters.read({"filter": {"radius_m": 0.5, **settings}}))
    f.add_platform(states if states is not None else platform())
    for part in np.array_split(np.arange(len(points)), batches):
        f.add(
            MappedPoints(
                *(getattr(points, k)[part] for k in ("t_ns", "r_map", "C_ind", "ring", "intensity"))
            )
        )
    return f, f.finish()


@pytest.fixture
def scene():
    return SimpleNamespace(
        platform=platform, mapped=mapped, sheet=sheet, filtered=filtered, SECOND=SECOND
    )

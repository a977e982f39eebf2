"""Places over triangles that nobody saw: all of their area, in a bounded number."""

from itertools import pairwise

import numpy as np
import pytest

from ladar_volume.volume.field_checks.gaps import CELLS, places_of


def fan(reach):
    """Triangles (t, 3, 3) from the points of one side of a square to one place far away."""
    y = np.linspace(0.0, 4.0, 41)
    return np.array([[[0, a, 0], [0, b, 0], [reach, 2.0, 1.0]] for a, b in pairwise(y)])


@pytest.mark.parametrize("reach", [3.0, 100.0, 1e4, 4e9])
def test_slivers_are_covered_as_triangles_are(reach):
    share = np.linspace(0.2, 1.0, 40)
    xy, area, height = places_of(fan(reach), share)
    assert len(xy) <= 16 * CELLS
    assert area.sum() == pytest.approx(0.5 * 0.1 * reach * share.sum(), rel=1e-9)
    # the middle of every triangle lies at a third of its way
    assert area @ xy[:, 0] / area.sum() == pytest.approx(reach / 3.0, rel=1e-9)
    assert area @ height / area.sum() == pytest.approx(1.0 / 3.0, rel=1e-9)

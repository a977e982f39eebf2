"""Blocks of filled cells against SciPy's morphology."""

import numpy as np
import pytest
from scipy import ndimage

from ladar_volume.tin.sampled_area import beside_full_blocks


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8, 0.95, 1.0])
@pytest.mark.parametrize("shape", [(5, 5), (3, 9), (40, 23)])
def test_blocks_are_those_of_erosion_and_dilation(share, shape):
    raster = np.random.default_rng(8).random(shape) < share
    block = np.ones((3, 3), bool)
    eroded = ndimage.binary_erosion(raster, block)
    assert (
        beside_full_blocks(raster) == ndimage.binary_dilation(eroded, block, iterations=2)
    ).all()

"""A cloud thinned to one spacing: a scanner passes a roof in close lines and a wall in a few wide
ones, and a mesh whose edges suit the former is open on the latter.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.math.random_halves import random_order
from ladar_volume.mesh.local_mesh import SPACING
from ladar_volume.model.records import F64, I64

#: The spacing at a point is the distance of the 6th neighbour; a cloud is thinned to this
#: percentile of it.
SPARSEST = 90.0
#: Of the random order.
SEED = 11


def sparse_spacing(r: F64) -> float:
    """Spacing, m, of points (n, 3) m where they are sparse; 0 for a single point."""
    if len(r) < 2:
        return 0.0
    k = min(SPACING, len(r) - 1)
    return float(np.percentile(np.asarray(cKDTree(r).query(r, [k + 1])[0]), SPARSEST))


def even_rows(r: F64, least_m: float) -> I64:
    """Ascending rows of points (n, 3) m of which none are nearer to each other than ``least_m``,
    and from which none of the others is farther. Which ones depends on where the points are, not
    on how they are numbered.
    """
    order = random_order(r, np.random.default_rng(SEED))
    tree, gone = cKDTree(r), np.zeros(len(r), np.bool_)
    kept = []
    for i in order:
        if not gone[i]:
            gone[tree.query_ball_point(r[i], least_m)] = True
            kept.append(i)
    return np.sort(np.array(kept, np.int64))

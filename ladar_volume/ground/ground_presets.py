"""Published settings of the ground (seed 002 section 9.3: those of the filter with T = 1000), as
keys and values of the section ``ground``.

T is the number of trials, k the points per random sample, polDeg the degree. A point belongs to a
surface within the published outliersThreshold; the surface with most points wins, whatever lies
below it. Lengths of Table 9.2 are printed in centimetres.
"""

from __future__ import annotations

from typing import Any

_PUBLISHED: dict[str, Any] = {"trials": 1000, "degree": 1, "threshold_m": 0.05, "below_weight": 0.0}

#: ``bench``: Table 9.1, bench and fountain, and the large cloud. ``box``: Table 9.2, cardboard box.
PRESETS: dict[str, dict[str, Any]] = {
    "bench": {**_PUBLISHED, "sample_size": 20},
    "box": {**_PUBLISHED, "sample_size": 10},
}

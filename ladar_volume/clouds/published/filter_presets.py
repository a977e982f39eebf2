"""Published settings of the filter (seed 002 section 9.1 and 9.3), as keys and values of
the filter of point cloud files.

delta is the range r (fits reach over 2 r), polDeg the degree, T the trials, minPts = polDeg k the
fewest points, sampling the grid before and after; residualsThreshold serves the RANSAC start, which
section 4.3 recommends. outliersThreshold, the published 5 cm, is a floor of the inlier threshold,
and with ``order: published`` the threshold itself. k = 20 or 10 points per random sample can hardly
survive the outliers it is meant for (a half of them leaves one sample in a million whole): the
presets take four, as section 4.3 recommends, and ``--set filter.sample_size=20`` what is printed.
"""

from __future__ import annotations

from typing import Any

from ladar_volume.model.cloud_filter_parameters import FILTERS, FilterParameters
from ladar_volume.model.parameter import read_section, specs

_BENCH: dict[str, Any] = {
    "radius_m": 0.2,
    "degree": 1,
    "trials": 200,
    "min_points": 20,
    "sampling_m": 0.03,
    "grid_before_m": 0.03,
    "grid_after_m": 0.03,
    "outlier_sigmas": 3.0,
    "outlier_floor_m": 0.05,
    "start": "ransac",
    "ransac_threshold_m": 0.02,
    "edges_threshold": 0.1,
}
_BOX: dict[str, Any] = {
    "radius_m": 0.3,
    "degree": 1,
    "trials": 300,
    "min_points": 10,
    "sampling_m": 0.02,
    "grid_before_m": 0.02,
    "grid_after_m": 0.02,
    "outlier_sigmas": 3.0,
    "outlier_floor_m": 0.05,
    "start": "ransac",
    "ransac_threshold_m": 0.03,
    "edges_threshold": 0.1,
}

#: ``bench``: Table 9.1, bench and fountain, in metres. ``box``: Table 9.2, cardboard box, printed
#: in centimetres, here in metres. ``sphere``: the same with degree 2, hence minPts 2 k. ``ground``:
#: Table 9.1 with T = 1000 (section 9.3).
PRESETS: dict[str, dict[str, Any]] = {
    "bench": _BENCH,
    "box": _BOX,
    "sphere": {**_BOX, "degree": 2, "min_points": 20},
    "ground": {**_BENCH, "trials": 1000},
}


def preset_keys(name: str, order: str = "published") -> dict[str, Any]:
    """Keys and values of a preset that the filter of this order reads."""
    known = {spec.key for spec in specs(FILTERS[order])}
    return {key: value for key, value in PRESETS[name].items() if key in known}


def preset(name: str, order: str = "published") -> FilterParameters:
    """Parameters of a preset for the filter of this order."""
    return read_section(FILTERS[order], "filter", preset_keys(name, order))

"""What the error propagation adds to one estimate of a volume from a million filtered points.

The filtered surface of the bundled stockpile, with its patches, their covariances and
sensitivities, is laid side by side many times on its own tilted ground; then all of it is one
volume above that ground, or one of the piles is. Processor time of one estimate is split into the
propagation (sensitivities, covariance, budget, ground roughness) and the rest (triangulation,
ground, outline, prismoids, near-base correction, boundary). Sigma of every vertex, no part of it,
is timed by itself. About 9 GB of memory at a million points.

``python -m benchmarks.propagation [POINTS]``
"""

from __future__ import annotations

import dataclasses
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, FilteredPoints, FilterUpdate, Patches
from ladar_volume.replay import Replay
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.packing import unpack_patches
from ladar_volume.uncertainty.volume_budget import Sources
from ladar_volume.volume import estimator as stage
from ladar_volume.volume import measured_body
from ladar_volume.volume.estimator import VolumeEstimator

BAG = Path(__file__).parents[1] / "bags" / "stockpile"
POINTS = 1_000_000
#: What the estimate calls for the sake of sigma alone.
PROPAGATION = (
    "Sources",
    "ground_inverse",
    "result_gradients",
    "ground_field",
    "sensitivities",
    "naive_sigma",
    "budget",
)
#: And what it does for the bias of cut and fill near the base, which counts as the rest.
REST = ("near_correction",)


def bundled() -> tuple[FilteredPoints, Patches, NavigationBins, Parameters]:
    """The filtered surface of the bundled survey, and what belongs to it."""
    with BagReader(BAG) as bag:
        replay = Replay(bag, read_config(BAG / "config.yaml"), bag.roles())
        replay.run()
    epoch = replay.engine.estimator.epoch()
    patches = epoch.sources.patches
    return (
        epoch.sources.points,
        unpack_patches(patches, 0, len(patches)),
        epoch.sources.navigation,
        replay.parameters,
    )


def slope_of(r: F64) -> F64:
    """Gradient (2,) of the plane through the lower half of points (n, 3)."""
    low = r[r[:, 2] < np.median(r[:, 2])]
    found: F64 = np.linalg.lstsq(
        np.c_[low, np.ones(len(low))][:, [0, 1, 3]], low[:, 2], rcond=None
    )[0][:2]
    return found


def tiled(points: FilteredPoints, patches: Patches, copies: int) -> FilterUpdate:
    """The surface laid side by side, each copy with patches of its own."""
    side, m = math.ceil(math.sqrt(copies)), len(patches)
    span = np.ptp(points.r_map[:, :2], axis=0) + 0.2
    slope, number = slope_of(points.r_map), np.arange(copies)
    xy = np.stack([number % side, number // side], axis=1) * span
    shift = np.c_[xy, xy @ slope]
    neighbour = np.minimum(np.searchsorted(patches.key, patches.cross_key), m - 1)
    known = patches.key[neighbour] == patches.cross_key
    cross_key = np.where(
        known, neighbour, np.iinfo(np.int64).max // 2
    )  # beyond the bundled survey's own edge

    def many(array: Any) -> Any:
        return np.tile(array, (copies, *[1] * (array.ndim - 1)))

    def moved(array: F64) -> F64:
        out: F64 = (array[None] + shift[:, None]).reshape(-1, 3)
        return out

    def numbered(row: Any) -> Any:
        return (row[None] + m * number[:, None]).ravel()

    def joined(start: Any) -> Any:
        return np.concatenate([[0], np.cumsum(np.tile(np.diff(start), copies))]).astype(np.int64)

    surface = {
        f.name: many(getattr(points, f.name))
        for f in dataclasses.fields(points)
        if f.name not in ("r_map", "patch")
    }
    own = np.searchsorted(patches.key, points.patch)
    made = {
        f.name: many(getattr(patches, f.name))
        for f in dataclasses.fields(patches)
        if not f.name.endswith(("key", "_start", "centre"))
    }
    return FilterUpdate(
        int(points.t_ns.max()),
        np.zeros(0, np.int64),
        FilteredPoints(**surface, r_map=moved(points.r_map), patch=numbered(own)),
        Patches(
            **made,
            key=numbered(np.arange(m)),
            centre=moved(patches.centre),
            cross_start=joined(patches.cross_start),
            cross_key=numbered(cross_key),
            nav_start=joined(patches.nav_start),
        ),
        complete=True,
    )


@contextmanager
def stopwatch(spent: dict[str, float]) -> Iterator[None]:
    """Adds up the processor time of the propagation while an estimate runs."""

    def measured(name: str, action: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            began = time.process_time()
            out = action(*arguments, **named)
            spent[name] = spent.get(name, 0.0) + time.process_time() - began
            return out

        return call

    class Timed(Sources):
        budget = measured("budget", Sources.budget)
        sensitivities = measured("sensitivities", Sources.sensitivities)
        naive_sigma = measured("naive_sigma", Sources.naive_sigma)

    def named_in(module: Any) -> dict[str, Any]:
        return {
            name: measured(name, getattr(module, name))
            for name in (*PROPAGATION, *REST)
            if hasattr(module, name)
        }

    replaced, steps = named_in(stage), named_in(measured_body)
    replaced["Sources"] = measured("Sources", Timed)
    steps["at_once"] = lambda one, two: (
        one(),
        two(),
    )  # one after the other, so that each part's time is its own
    with (
        mock.patch.multiple(stage, **replaced),
        mock.patch.multiple(measured_body, **steps),
    ):
        yield


def timed(estimator: VolumeEstimator) -> dict[str, float | int | str]:
    """Processor seconds of one estimate and of its parts; the second of two, so that everything is
    compiled.
    """
    out: dict[str, float | int | str] = {}
    for _ in range(2):
        spent: dict[str, float] = {}
        estimator.set_parameters(estimator.parameters)  # forgets the surface
        with stopwatch(spent):
            wall, cpu = time.perf_counter(), time.process_time()
            found = estimator.estimate()
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        propagation = sum(s for name, s in spent.items() if name in PROPAGATION)
        out = {
            "vertices": len(found.tin.vertices),
            "V / m³": found.volume.volume_m3,
            "sigma / m³": found.volume.sigma_m3,
            "one estimate, CPU / s": cpu,
            "one estimate, wall / s": wall,
            "propagation, CPU / s": propagation,
            "propagation / rest": propagation / (cpu - propagation),
            **{f"  {name}, CPU / s": s for name, s in spent.items()},
        }
    return out


def run(points: int = POINTS) -> dict[str, float | int | str]:
    """The whole surface as one body, and one pile of it."""
    surface, patches, navigation, parameters = bundled()
    estimator = VolumeEstimator(parameters, navigation)
    estimator.add(tiled(surface, patches, math.ceil(points / len(surface))))
    del surface, patches
    estimator.epoch()  # merges the update
    out: dict[str, float | int | str] = {}
    for outline, words in (("all", "all of it"), ("auto", "one pile")):
        estimator.set_parameters(
            dataclasses.replace(
                parameters, volume=dataclasses.replace(parameters.volume, outline=outline)
            )
        )
        out.update({f"{words}: {key}": value for key, value in timed(estimator).items()})
    epoch, began = estimator.epoch(), time.process_time()
    epoch.sigma_z()
    out["sigma of every vertex, CPU / s"] = time.process_time() - began
    return out


if __name__ == "__main__":
    for key, value in run(int(sys.argv[1]) if len(sys.argv) > 1 else POINTS).items():
        print(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")

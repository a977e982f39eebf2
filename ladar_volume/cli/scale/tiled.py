"""``ladar_volume replay --dask``: a recording replayed by tiles."""

from __future__ import annotations

import argparse
import importlib.util
from typing import Any

from rich.console import Console

from ladar_volume.cli.arguments.scale.work_options import TILE_M
from ladar_volume.cli.scale.workers import progress_on, workers_of
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.records import Estimate
from ladar_volume.replay import Replay


def run_by_tiles(replay: Replay, arguments: argparse.Namespace) -> tuple[Estimate, dict[str, Any]]:
    """Replay by tiles; returns the estimate and a section ``tiles`` for the result. Raises
    :class:`ConfigurationError` where the packages for it are not installed.
    """
    from ladar_volume.tiled_replay.tiled_survey import TiledReplay, Work

    missing = [n for n in ("pyarrow", "distributed") if importlib.util.find_spec(n) is None]
    if "pyarrow" in missing or (missing and arguments.dask is not None):
        words = f"{' and '.join(missing)} not installed: pip install 'ladar_volume[scale]'"
        raise ConfigurationError(words, value=missing)
    a, console = arguments, Console(stderr=True)
    bag = a.bag.resolve()
    store = a.store or bag.with_name(bag.name + ".tiles")
    with workers_of(a, console) as workers, progress_on(console) as progress:
        tiled = TiledReplay(replay, Work(a.tile or TILE_M, store, workers))
        estimate = tiled.run(progress)
    for words in tiled.words:
        console.print(words, markup=False)
    return estimate, {"tiles": tiled.facts}

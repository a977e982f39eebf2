"""Who works on tiles, and how far they are."""

from __future__ import annotations

import argparse
import logging
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeAlias

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from ladar_volume.model.errors import ConfigurationError, LadarVolumeError
from ladar_volume.process.interrupts import interrupts_wait
from ladar_volume.tiles.tile_work import DaskWorkers, OwnProcess, Workers

if TYPE_CHECKING:  # Dask is needed with workers alone
    from distributed import LocalCluster

#: How often processes are started that end before all are up.
STARTS = 5
#: Settings of Dask: its profiler stops a worker's thread a hundred times a second, and its clocks
#: and monitors wake each process sixty times, which takes 3 % of all CPU time. Workers are forked
#: from one process that has imported what they need, not each by itself.
QUIET = {
    "distributed.worker.multiprocessing-method": "forkserver",
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "2s",
    "distributed.worker.memory.monitor-interval": "500ms",
}
#: Called with the stage, the share of it that is done, and points done so far.
Progress: TypeAlias = Callable[[str, float, int], None]


def check_workers(a: argparse.Namespace) -> None:
    """Raises :class:`ConfigurationError` for ``--workers`` that cannot be."""
    if a.workers is not None and (a.workers < 1 or a.dask != ""):
        raise ConfigurationError("--workers N, 1 or more, goes with --dask without an address")


@contextmanager
def workers_of(a: argparse.Namespace, console: Console) -> Iterator[Workers]:
    """Who works: this process, workers of this machine, or those of a scheduler. Raises
    :class:`ConfigurationError` for a scheduler that does not answer.
    """
    if a.dask is None:
        yield OwnProcess()
        return
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our errors say it in one line
    if a.dask:
        try:
            client = Client(a.dask, timeout="3s")  # type: ignore[no-untyped-call]
        except (OSError, ValueError) as error:
            words = f"--dask {a.dask}: no scheduler answers there"
            raise ConfigurationError(words, value=a.dask) from error
        with client:
            console.print(f"dashboard {client.dashboard_link}")
            yield DaskWorkers(client)
        return
    with (
        local_cluster(a.workers or os.cpu_count() or 1) as cluster,
        Client(cluster) as client,  # type: ignore[no-untyped-call]
    ):
        console.print(f"dashboard {client.dashboard_link}")
        yield DaskWorkers(client)


def local_cluster(workers: int) -> LocalCluster:
    """So many processes of one thread. One that is lost before all are up takes the others with it:
    they are started again. Raises :class:`LadarVolumeError` where that does not help.
    """
    import dask
    from distributed import LocalCluster, utils

    # its own list has packages that no worker needs here
    utils._forkserver_preload_set = True
    multiprocessing.get_context("forkserver").set_forkserver_preload(
        ["distributed", *own_modules()]
    )
    for _ in range(STARTS):
        try:
            with dask.config.set(QUIET), interrupts_wait():
                return LocalCluster(  # type: ignore[no-untyped-call]
                    n_workers=workers,
                    threads_per_worker=1,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
        except RuntimeError as error:
            why = str(error).rstrip(".")
    raise LadarVolumeError(f"workers do not start: {why}", reason="workers_lost")


def own_modules() -> list[str]:
    """Modules of this package that this process has imported, as workers need them, but the one
    that was run: each worker runs that as its own.
    """
    run = getattr(getattr(sys.modules["__main__"], "__spec__", None), "name", "")
    own = (name for name in list(sys.modules) if name.split(".")[0] == "ladar_volume")
    return [name for name in own if name != run]


@contextmanager
def progress_on(console: Console) -> Iterator[Progress]:
    """One bar for each stage, with the time left and points a second."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[speed]}"),
    )
    with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        stages: dict[str, tuple[Any, float]] = {}
        before = time.monotonic()

        def progress(stage: str, share: float, points: int) -> None:
            nonlocal before
            now = time.monotonic()
            if stage not in stages:
                stages[stage] = bars.add_task(stage, total=1.0, speed=""), before
            bar, began = stages[stage]
            speed = f"{points / max(now - began, 1e-9):,.0f} points/s"
            bars.update(bar, completed=share, speed=speed)
            before = now

        yield progress

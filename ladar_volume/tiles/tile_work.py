"""Who does the work of all tiles: this process, or Dask."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeVar

from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.process.memory import keep_blocks

A = TypeVar("A")
B = TypeVar("B")

#: How often a task may lose its worker.
LOSSES = 20


class Workers(Protocol):
    """Who does tasks that do not depend on one another, in any order."""

    @property
    def memory_bytes(self) -> int | None:
        """Memory of the smallest of them, None where it has no limit."""
        ...

    def run(self, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
        """The results, as they are ready."""
        ...


class OwnProcess:
    """One task after the other, here."""

    memory_bytes = None

    def run(self, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
        """The results in order."""
        yield from map(task, of)


class DaskWorkers:
    """The workers of a Dask client (``distributed.Client``)."""

    def __init__(self, client: object) -> None:
        self.client = client

    @property
    def memory_bytes(self) -> int | None:
        """Memory of the smallest worker, None where none has a limit."""
        info = self.client.scheduler_info(n_workers=-1)  # type: ignore[attr-defined]
        known = info["workers"].values()
        return min((w["memory_limit"] for w in known if w["memory_limit"]), default=None)

    def run(self, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
        """The results as workers return them; a task whose worker is lost goes to another one."""
        from distributed import CancelledError, KilledWorker, as_completed

        start = self.client.map  # type: ignore[attr-defined]
        futures = start(partial(on_one_thread, task), of, pure=False, retries=LOSSES)
        # results come with what is done: asking for each takes a millisecond or two
        done = as_completed(futures, with_results=True)  # type: ignore[no-untyped-call]
        try:
            for future, result in done:
                yield result
                future.release()
        except KilledWorker as error:
            words = f"a task lost its worker {LOSSES} times: give smaller tiles, or more memory"
            raise LadarVolumeError(words, reason="workers_lost") from error
        except (CancelledError, OSError) as error:
            words = "the scheduler is gone: start it and run again, what is done is kept"
            raise LadarVolumeError(words, reason="workers_lost") from error


def on_one_thread(task: Callable[[A], B], at: A) -> B:
    """A task on one thread: workers share the cores by tasks."""
    import numba

    keep_blocks()
    numba.set_num_threads(1)
    return task(at)


@dataclass(frozen=True)
class Failure:
    """What went wrong in a task, as it travels between processes: the error's class, its words, its
    reason, its value.
    """

    kind: type[LadarVolumeError]
    words: str
    reason: str
    value: object = None


def run_guarded(task: Callable[[A], B], at: A) -> B | Failure:
    """The result, or the error it ended with."""
    try:
        return task(at)
    except LadarVolumeError as error:
        return Failure(type(error), str(error), error.reason, error.value)
    except OSError as error:
        return Failure(LadarVolumeError, f"{error.strerror or error}", "output_unwritable")


def each_result(workers: Workers, task: Callable[[A], B], of: Sequence[A]) -> Iterator[B]:
    """The results in any order, as they are ready. Raises the first error."""
    for found in workers.run(partial(run_guarded, task), of):
        if isinstance(found, Failure):
            raise found.kind(found.words, reason=found.reason, value=found.value)
        yield found


def results(
    workers: Workers, task: Callable[[A], B], of: Sequence[A], progress: Callable[[B], None]
) -> list[B]:
    """All results, in any order. Raises the first error."""
    out: list[B] = []
    for found in each_result(workers, task, of):
        progress(found)
        out.append(found)
    return out

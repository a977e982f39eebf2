"""How the tests are spread over processes. What compiles the same kernels stays in one process: two
that need a kernel at the same time both compile it, which takes longer than the tests. So do all
tests that start nodes: they share two cores and the loopback.
"""

import gc
from pathlib import Path
from typing import Any

import pytest

from ladar_volume.process.switch import own_process

gc.disable()  # to the end of the collection, see below
own_process()  # before NumPy, which reads then how many threads it may use

HERE = Path(__file__).parent
TOGETHER = {
    "online": ("nodes", "process", "io", "georeference"),
    "verbs": ("cli",),
    "clouds": ("clouds", "rmls"),
}
GROUP = {folder: name for name, folders in TOGETHER.items() for folder in folders}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The groups come first: they take longest, and the files that follow fill up what is left of
    either process.
    """
    items.sort(key=lambda item: item.path.relative_to(HERE).parts[0] not in GROUP)


def pytest_collection_finish() -> None:
    """The objects of thousands of tests stay to the end: no search for cycles need look at them."""
    from ladar_volume.compile_kernels import RARE_COLLECTIONS

    gc.freeze()
    gc.set_threshold(*RARE_COLLECTIONS)
    gc.enable()


def pytest_unconfigure() -> None:
    """Libraries look at the end whether all of their objects are gone."""
    gc.unfreeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """pytest-xdist's own groups (its last, 3.8) are lost with pytest 9.2: what it adds to the name
    of a test is no longer read.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByGroup(LoadScopeScheduling):
        """One process takes a whole group, or a file that belongs to none."""

        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.split("::")[0]
            return GROUP.get(Path(file).parts[1], file)

    return ByGroup(config, log)

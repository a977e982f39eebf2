"""How the tests are spread over processes (``--dist loadgroup``). What compiles the same kernels
stays in one process: two that need a kernel at the same time both compile it, which takes longer
than the tests. So do all tests that start nodes: they share two cores and the loopback.
"""

from pathlib import Path

import pytest

from ladar_volume.process.switch import own_process

own_process()  # before NumPy, which reads then how many threads it may use

HERE = Path(__file__).parent
TOGETHER = {
    "online": ("nodes", "process", "io", "georeference"),
    "clouds": ("cli", "clouds", "rmls"),
}
GROUP = {folder: name for name, folders in TOGETHER.items() for folder in folders}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """One process takes a whole group, or a file that belongs to none. The groups come first: they
    take longest, and the files that follow fill up what is left of either process.
    """
    items.sort(key=lambda item: item.path.relative_to(HERE).parts[0] not in GROUP)
    for item in items:
        file = item.path.relative_to(HERE)
        item.add_marker(pytest.mark.xdist_group(GROUP.get(file.parts[0], str(file))))

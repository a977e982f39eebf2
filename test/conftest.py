"""How the tests are spread over processes: what runs the same compiled kernels stays together, since two processes that need a kernel at
the same time both compile it, and compiling takes longer than the tests; so do all that start nodes, which meet on the loopback."""

from pathlib import Path

import pytest

HERE = Path(__file__).parent
TOGETHER = {
    "online": ("nodes", "io", "georeference", "calibration", "simulation"),
    "clouds": ("filtering", "benchmarks", "cli", "studies"),
    "surfaces": ("surface",),
}
GROUP = {folder: name for name, folders in TOGETHER.items() for folder in folders}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        item.add_marker(pytest.mark.xdist_group(GROUP.get(item.path.relative_to(HERE).parts[0], "volumes")))

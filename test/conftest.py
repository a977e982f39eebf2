"""How the tests are spread over processes: a file stays together, and so do all that start nodes, which meet on the loopback."""

from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        place = item.path.relative_to(HERE)
        item.add_marker(pytest.mark.xdist_group("nodes" if place.parts[0] == "nodes" else str(place)))

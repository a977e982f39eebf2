"""The programs of the nodes: ``python -m ladar_volume.nodes.programs NODE [ROS arguments]``, and a
command for each. A program sets its process up before anything loads NumPy.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Sequence
from functools import partial

from ladar_volume.process.numpy_names import hide_numpy_tools
from ladar_volume.process.switch import own_process

NODES = ("georeference_node", "filter_node", "volume_node", "logger_node", "mavlink_node", "player")


def _end(*_: object) -> None:
    raise SystemExit(0)


def run(node: str, argv: Sequence[str] | None = None) -> int:
    """Set the process up, then run the node's ``main``. Returns the exit code. Until the node is
    there to end in order, a signal just ends the process: nothing was taken in yet.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _end)
    own_process()
    hide_numpy_tools()
    return int(importlib.import_module(f"ladar_volume.nodes.{node}").main(argv))


georeference_node = partial(run, "georeference_node")
filter_node = partial(run, "filter_node")
volume_node = partial(run, "volume_node")
logger_node = partial(run, "logger_node")
mavlink_node = partial(run, "mavlink_node")
player = partial(run, "player")


def main(argv: Sequence[str] | None = None) -> int:
    """``programs NODE ...``: run one node."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] not in NODES:
        print(f"usage: programs {{{','.join(NODES)}}} ...", file=sys.stderr)  # noqa: T201
        return 2
    # rclpy drops the program's name, the player takes none
    return run(words[0], words[1:] if words[0] == "player" else words)


if __name__ == "__main__":
    sys.exit(main())

"""Cut a recording: ``python tools/cut_bag.py SOURCE OUT --start S --duration S``; all topics,
messages untouched.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ladar_volume.io.bags import BagReader, BagWriter


def main() -> None:
    """Copy the messages received in the interval."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--start", type=float, default=0.0)
    parser.add_argument("--duration", type=float, default=float("inf"))
    arguments = parser.parse_args()
    with BagReader(arguments.source) as source, BagWriter(arguments.out) as out:
        first = source.start_ns + int(arguments.start * 1e9)
        last = first + int(min(arguments.duration, source.duration_s) * 1e9)
        for raw in source.raw():
            if first <= raw.t_ns <= last:
                out.write_raw(raw.topic, raw.kind, bytes(raw.data), raw.t_ns)


if __name__ == "__main__":
    main()

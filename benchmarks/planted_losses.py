"""Losses planted in each node and in the log: do the books of the soak find each of them?

``python -m benchmarks.planted_losses [--seconds 20] [WORD ...]``: a flight without faults through
the four nodes of a copy of the package, once as it is and once with each loss; exit code 1 where
the books do not close without a loss, or close with one.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.planted import ROOT, planted_in


@dataclass(frozen=True)
class Loss:
    """name · file, below ladar_volume/nodes · good, bad : what is replaced by what, once"""

    name: str
    file: str
    good: str
    bad: str


#: True at every fifth call, from the given one on.
FIFTH = "next(FIFTH) % 5 == 0"
COUNTER = "import itertools\n\nFIFTH = itertools.count(1)\n"
LOSSES = (
    Loss(
        "georeference_node drops every fifth cloud",
        "georeference_node.py",
        '"cloud": lambda m: stage.add_returns(self._returns_of(m)),',
        f'"cloud": lambda m: {FIFTH} or stage.add_returns(self._returns_of(m)),',
    ),
    Loss(
        "georeference_node reads a cloud and forgets it",
        "georeference_node.py",
        '"cloud": lambda m: stage.add_returns(self._returns_of(m)),',
        f'"cloud": lambda m: (lambda r: {FIFTH} or stage.add_returns(r))(self._returns_of(m)),',
    ),
    Loss(
        "georeference_node sends too little of what it counted",
        "georeference_node.py",
        "self._points.publish(table_message(columns, stamp, self._map))",
        f"{FIFTH} or self._points.publish(table_message(columns, stamp, self._map))",
    ),
    Loss(
        "georeference_node counts a state twice",
        "georeference_node.py",
        'self.sent["states"] += len(states)',
        f'self.sent["states"] += len(states) + ({FIFTH})',
    ),
    Loss(
        "filter_node drops every fifth cloud",
        "filter_node.py",
        'if kind == "points":\n            return self._add(item)',
        f'if kind == "points":\n            return None if {FIFTH} else self._add(item)',
    ),
    Loss(
        "filter_node counts points and does not add them",
        "filter_node.py",
        "self.stage.add(points)",
        f"{FIFTH} or self.stage.add(points)",
    ),
    Loss(
        "filter_node sends patches without their points",
        "filter_node.py",
        "self._points.publish(table_message(points, self._sent_ns, frame))",
        f"{FIFTH} or self._points.publish(table_message(points, self._sent_ns, frame))",
    ),
    Loss(
        "volume_node drops every fifth update",
        "volume_node.py",
        'self.counts["parts"] += 1',
        f"if {FIFTH}:\n            return\n        self.counts['parts'] += 1",
    ),
    Loss(
        "volume_node does not hear every fifth table",
        "base.py",
        'if kind == "datum":\n            self._see_datum()',
        f'if kind == "patches" and {FIFTH}:\n            return\n'
        '        if kind == "datum":\n            self._see_datum()',
    ),
    Loss(
        "logger_node drops every fifth message",
        "logger_node.py",
        "self._recorder.write(",
        f"{FIFTH} or self._recorder.write(",
    ),
    Loss(
        "logger_node names written messages lost",
        "logger_node.py",
        "        self._offered += len(data)\n",
        f"        self._recorder.account(name).queue += {FIFTH}\n"
        "        self._offered += len(data)\n",
    ),
)


def books_close(tree: Path, seconds: float) -> tuple[bool, list[str]]:
    """Whether a flight through the nodes of ``tree`` ends with closed books, and what is open."""
    command = [sys.executable, "-m", "benchmarks.soak", "--seconds", str(seconds), "--faults", ""]
    paths = os.pathsep.join([str(tree), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=tree, env=environment, capture_output=True, text=True, timeout=600
    )
    if not done.stdout.startswith("{"):
        raise SystemExit(f"the flight did not end: {done.stderr[-500:]}")
    wrong = json.loads(done.stdout)["wrong"]
    return done.returncode == 0, wrong


def found(loss: Loss, tree: Path, seconds: float) -> list[str]:
    """What the books say with the loss."""
    file = tree / "ladar_volume" / "nodes" / loss.file
    text = file.read_text(encoding="utf-8")
    if text.count(loss.good) != 1:
        raise SystemExit(f"{loss.name}: {loss.file} has changed, plant it anew")
    first = text.index("\n", text.index("from __future__")) + 1
    bad = text[:first] + "\n" + COUNTER + text[first:].replace(loss.good, loss.bad)
    with planted_in(file, bad):
        return books_close(tree, seconds)[1]


def main() -> int:
    """Plant, fly, and say which the books found."""
    parser = argparse.ArgumentParser(description="losses planted in the nodes")
    parser.add_argument("words", nargs="*")
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()
    wanted = [x for x in LOSSES if all(w in x.name for w in arguments.words)]
    with tempfile.TemporaryDirectory() as name:
        tree = Path(name) / "tree"
        skip = shutil.ignore_patterns(".git", ".venv", "docs", "out", "build", "install")
        shutil.copytree(ROOT, tree, ignore=skip)
        closed, wrong = books_close(tree, arguments.seconds)
        print("without a loss:", "closed" if closed else wrong, flush=True)
        seen = 0
        for loss in wanted:
            wrong = found(loss, tree, arguments.seconds)
            seen += bool(wrong)
            print(f"{'found' if wrong else 'NOT FOUND'}: {loss.name}: {wrong[:1]}", flush=True)
    print(f"{seen} of {len(wanted)} found")
    return int(not closed or seen < len(wanted))


if __name__ == "__main__":
    sys.exit(main())

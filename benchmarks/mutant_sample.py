"""Mutants of the core at random, and the share of them that the tests see.

Each is one of cosmic-ray's changes of one place: another of + - * /, another comparison, and for
or, a condition reversed, True for False, a number by one, a loop left out, a minus dropped. Changes
that fail at once, as ``+`` to ``<<`` or another variable's name, are left out: they flatter the
score. So are changes in annotations and of docstrings, which change nothing.

A mutant is tried against the tests of its room and those that import its module, these first.
``--file`` chooses among the modules, ``--plain`` leaves out those with compiled kernels, which take
minutes.

``python -m benchmarks.mutant_sample [--count N] [--seed S] [--plain] [--file WORD]``; prints each
survivor as a difference, and the score with its 95 % interval (Wilson).
"""

from __future__ import annotations

import argparse
import ast
import difflib
import math
import random
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.planted import ROOT, SECONDS, passes_all, planted_in

#: Tests of every room, and of the log.
EVERY = ("test/test_room_formulas.py", "test/test_frozen_records.py")
LOG = ("test/io/test_recorder.py", "test/test_planted_bugs.py", "test/test_frozen_records.py")
#: Rooms, and the tests of each after those that name the module.
ROOMS = {
    "georeference": ("test/georeference", *EVERY),
    "rmls": ("test/rmls", *EVERY),
    "uncertainty": ("test/uncertainty", *EVERY),
    "volume": ("test/volume", *EVERY),
    "io/mcap_log.py": LOG,
    "io/mcap_recovery.py": LOG,
    "io/recorder.py": LOG,
}
ARITHMETIC, ORDER = ("Add", "Sub", "Mul", "Div"), ("Lt", "LtE", "Gt", "GtE", "Eq", "NotEq")
SINGLE = (
    *("AddNot", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr"),
    *("ReplaceOrWithAnd", "ReplaceBreakWithContinue", "ReplaceContinueWithBreak"),
    *("NumberReplacer", "ZeroIterationForLoop", "ReplaceUnaryOperator_Delete_USub"),
    "ReplaceUnaryOperator_Delete_Not",
)


@dataclass(frozen=True)
class Mutant:
    """file : below ladar_volume · operator · number : of its places in the file · line"""

    file: str
    operator: str
    number: int
    line: int


def operators() -> list[str]:
    """Names of the changes."""
    pairs = [f"ReplaceBinaryOperator_{a}_{b}" for a in ARITHMETIC for b in ARITHMETIC if a != b]
    pairs += [f"ReplaceComparisonOperator_{a}_{b}" for a in ORDER for b in ORDER if a != b]
    return [f"core/{name}" for name in (*pairs, *SINGLE)]


def modules() -> list[Path]:
    """Files of the core, below the package."""
    package = ROOT / "ladar_volume"
    found = [package / r for r in ROOMS]
    files = [p for r in found for p in ([r] if r.is_file() else sorted(r.glob("*.py")))]
    return [p for p in files if p.name != "__init__.py"]


def idle_lines(text: str) -> set[int]:
    """Lines of annotations and docstrings."""
    out: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        notes: list[Any] = [getattr(node, "annotation", None), getattr(node, "returns", None)]
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            notes.append(node)
        for one in notes:
            if isinstance(one, ast.AST) and hasattr(one, "lineno"):
                value = getattr(node, "value", None)
                if value is None or isinstance(value, ast.Constant):
                    out |= set(range(one.lineno, (one.end_lineno or one.lineno) + 1))
    return out


def places(path: Path, names: list[str]) -> list[Mutant]:
    """All mutants of a file."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator

    text = path.read_text(encoding="utf-8")
    idle, nodes = idle_lines(text), list(ast_nodes(get_ast(text)))
    out = []
    for name in names:
        operator, number = get_operator(name)(), 0
        for node in nodes:
            for (line, _), _ in operator.mutation_positions(node):
                if line not in idle:
                    file = str(path.relative_to(ROOT / "ladar_volume"))
                    out.append(Mutant(file, name, number, line))
                number += 1
    return out


def changed(mutant: Mutant, text: str) -> str:
    """The text of the file with the mutant."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    out = mutate_code(text, get_operator(mutant.operator)(), mutant.number)
    if out is None:
        raise SystemExit(f"{mutant}: no such place")
    return str(out)


def tests_of(mutant: Mutant, tree: Path) -> list[str]:
    """Tests of the room, and of others that import the module; first files that name it."""
    start = next(r for r in ROOMS if mutant.file.startswith(r))
    name, dotted = Path(mutant.file).stem, mutant.file.removesuffix(".py").replace("/", ".")
    own = [
        p for t in ROOMS[start] for p in ([tree / t] if t.endswith(".py") else of_folder(tree / t))
    ]
    text = {p: p.read_text(encoding="utf-8") for p in sorted((tree / "test").rglob("test_*.py"))}
    own += [p for p in text if p not in own and f"ladar_volume.{dotted} import" in text[p]]
    own.sort(key=lambda p: name not in text[p])
    return [str(p.relative_to(tree)) for p in own]


def of_folder(folder: Path) -> list[Path]:
    """Test files of a folder."""
    return sorted(folder.glob("test_*.py"))


def interval(seen: int, tried: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    z, p = 1.96, seen / tried
    middle, half = (
        p + z * z / (2 * tried),
        z * math.sqrt(p * (1 - p) / tried + (z / (2 * tried)) ** 2),
    )
    return (middle - half) / (1 + z * z / tried), (middle + half) / (1 + z * z / tried)


def sample(count: int, seed: int, plain: bool, word: str) -> list[Mutant]:
    """Mutants at random, every place alike."""
    files = [p for p in modules() if word in str(p)]
    if plain:
        files = [p for p in files if "math.kernels" not in p.read_text(encoding="utf-8")]
    names = operators()
    found = [m for p in files for m in places(p, names)]
    print(f"{len(found)} mutants in {len(files)} files", flush=True)
    return random.Random(seed).sample(found, min(count, len(found)))


def main() -> int:
    """Try them."""
    parser = argparse.ArgumentParser(description="mutants of the core, a sample")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true", help="no modules with compiled kernels")
    parser.add_argument("--file", default="", help="modules whose path holds this")
    a = parser.parse_args()
    seen = tried = 0
    with tempfile.TemporaryDirectory() as name:
        tree = Path(name) / "tree"
        skip = shutil.ignore_patterns(".git", ".venv", "out", "build", "install")
        shutil.copytree(ROOT, tree, ignore=skip)
        for mutant in sample(a.count, a.seed, a.plain, a.file):
            file = tree / "ladar_volume" / mutant.file
            good = file.read_text(encoding="utf-8")
            bad, began = changed(mutant, good), time.monotonic()
            with planted_in(file, bad):
                there = not passes_all(tests_of(mutant, tree), tree)
            if time.monotonic() - began >= SECONDS:
                print(f"NO END: {mutant}", flush=True)
                continue
            seen, tried = seen + there, tried + 1
            print(f"{'seen' if there else 'SURVIVES'}: {mutant} ({time.monotonic() - began:.0f} s)")
            if not there:
                rows = difflib.unified_diff(good.splitlines(), bad.splitlines(), n=0, lineterm="")
                print("\n".join(list(rows)[2:]))
            sys.stdout.flush()
    low, high = interval(seen, tried) if tried else (0.0, 1.0)
    print(f"{seen} of {tried} seen: {seen / max(tried, 1):.3f}, 95 % {low:.3f} to {high:.3f}")
    return int(seen < tried)


if __name__ == "__main__":
    sys.exit(main())

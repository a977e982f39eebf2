"""Bugs planted one after the other in a copy of the package: the tests must see each of them.

``python -m benchmarks.planted [WORD ...]``: all of them, or those whose name holds a word; exit
code 1 where one is not seen. The copy is made in a temporary folder; the tree stays as it is.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.forked_tests import run_tests

ROOT = Path(__file__).parents[1]
HERE = "test/test_planted_bugs.py"
#: A test whose kernels are compiled anew takes minutes; one that hangs has seen its bug.
SECONDS = 900
#: A file with kernels imports their decorators.
HOLDS = "math.kernels"


@dataclass(frozen=True)
class Bug:
    """name · file, below ladar_volume · good, bad : what is replaced by what · test : the file that
    sees it · function : of the test
    """

    name: str
    file: str
    good: str
    bad: str
    function: str
    test: str = HERE


BUGS = (
    Bug(
        "convergence on the body's side",
        "georeference/trajectory.py",
        "multiply_quaternions(turn[turned], q[turned])",
        "multiply_quaternions(q[turned], turn[turned])",
        "test_convergence_turns_the_map_and_not_the_body",
    ),
    Bug(
        "covariance of a fix turned by the transpose",
        "georeference/georeferencer.py",
        "turn @ C_enu @ turn.T",
        "turn.T @ C_enu @ turn",
        "test_the_covariance_of_a_fix_turns_into_the_map",
    ),
    Bug(
        "min_points ignored",
        "rmls/refit_kernels.py",
        "< rule.min_points",
        "< 5",
        "test_a_patch_has_its_fewest_points",
        "test/rmls/test_filter_admission.py",
    ),
    Bug(
        "registration of the second epoch forgotten",
        "change/change_detection.py",
        "    for epoch in (own, other):",
        "    for epoch in (own,):",
        "test_the_registration_of_either_epoch_counts",
    ),
    Bug(
        "a cluster of the fewest points left out",
        "ground/clusters.py",
        "count[by_size] >= min_points",
        "count[by_size] > min_points",
        "test_a_cluster_of_the_fewest_points_is_one",
    ),
    Bug(
        "TIMESYNC without halving",
        "io/mavlink/mavlink_records.py",
        "0.5 * (received_ns - sent_ns)",
        "1.0 * (received_ns - sent_ns)",
        "test_half_a_round_trip_is_the_delay",
    ),
    Bug(
        "checksum of a tlog always good",
        "io/mavlink/mavlink_stream.py",
        "return bool(crc == int",
        "return bool(crc == crc or int",
        "test_a_frame_with_a_wrong_checksum_is_noise",
    ),
    Bug(
        "no fdatasync after a chunk",
        "io/mcap_log.py",
        "_confirm(self._descriptor)",
        "pass",
        "test_each_chunk_is_confirmed_by_default",
    ),
    Bug(
        "sync chunk never asked for",
        "io/mcap_log.py",
        "self.syncer.request()",
        "pass",
        "test_each_chunk_is_confirmed_by_default",
    ),
    Bug(
        "a log closed without fsync",
        "io/mcap_log.py",
        "os.fsync(self._stream.fileno())",
        "pass",
        "test_a_finished_file_is_confirmed",
    ),
    Bug(
        "a log repaired without fsync",
        "io/mcap_recovery.py",
        "os.fsync(stream.fileno())",
        "pass",
        "test_a_repaired_file_is_confirmed",
    ),
    Bug(
        "loss by a full queue not counted",
        "nodes/logger_node.py",
        "self._recorder.account(name).queue += 1",
        "pass",
        "test_what_the_queue_of_the_log_does_not_take_is_counted",
    ),
    Bug(
        "delete_oldest takes the file being written",
        "io/recorder.py",
        "if self.free() >= enough or (old == self.path and self._log is not None):",
        "if self.free() >= enough:",
        "test_the_file_being_written_is_never_deleted",
    ),
    Bug(
        "digest of the first file alone",
        "io/bags.py",
        "for file in files:",
        "for file in files[:1]:",
        "test_the_digest_is_of_all_files",
    ),
    Bug(
        "announced count of LAS not held against the points",
        "io/pointfiles/las.py",
        'if len(out["x"]) != announced:',
        "if False:",
        "test_fewer_points_than_announced_are_refused",
    ),
)


def seen(bug: Bug, tree: Path) -> bool:
    """Whether the test fails with the bug in the copy ``tree``, and passes without."""
    file = tree / "ladar_volume" / bug.file
    good = file.read_text(encoding="utf-8")
    if bug.good not in good:
        raise SystemExit(f"{bug.name}: {bug.file} has changed, plant it anew")
    if passes(bug, tree) is False:
        raise SystemExit(f"{bug.name}: {bug.function} fails without the bug")
    with planted_in(file, good.replace(bug.good, bug.bad)):
        return not passes(bug, tree)


def passes(bug: Bug, tree: Path) -> bool:
    """Whether the one test passes in the copy."""
    return passes_all([f"{bug.test}::{bug.function}"], tree)


def passes_all(tests: list[str], tree: Path) -> bool:
    """Whether tests, by file or function, pass in the copy; one that hangs does not."""
    with tempfile.TemporaryDirectory() as name:
        output = Path(name) / "said"
        code = run_tests(tests, tree, SECONDS, output)
        if code not in (0, 1, None):
            words = output.read_text(encoding="utf-8", errors="replace")
            raise SystemExit(f"{tests}: the tests did not run: {words[-500:]}")
    return code == 0


@contextmanager
def planted_in(file: Path, bad: str) -> Iterator[None]:
    """A file with another text within the block. Its compiled kernels, and those of files that
    hold them, are laid aside, and come back afterwards with the file's own time.
    """
    good, at = file.read_bytes(), file.stat()
    files = holders(file)
    with tempfile.TemporaryDirectory() as name:
        aside = [Path(name) / str(k) for k in range(len(files))]
        for one, folder in zip(files, aside, strict=True):
            folder.mkdir()
            for cache in kernels_of(one):
                shutil.move(cache, folder)
        try:
            file.write_text(bad, encoding="utf-8")
            yield
        finally:
            file.write_bytes(good)
            os.utime(file, ns=(at.st_atime_ns, at.st_mtime_ns))
            for one, folder in zip(files, aside, strict=True):
                for cache in kernels_of(one):
                    cache.unlink()
                for old in folder.iterdir():
                    shutil.move(old, one.parent / "__pycache__")


def holders(file: Path) -> list[Path]:
    """The file, and those whose kernels may hold its own: they import it, or one that does."""
    package = next(p for p in file.parents if p.name == "ladar_volume")
    texts = {p: p.read_text(encoding="utf-8") for p in sorted(package.rglob("*.py"))}
    texts = {p: text for p, text in texts.items() if HOLDS in text}
    found, news = [file], [file]
    while news:
        word = re.compile("|".join(imports_of(p.relative_to(package.parent)) for p in news))
        news = [p for p, text in texts.items() if p not in found and word.search(text)]
        found += news
    return found


def imports_of(file: Path) -> str:
    """Pattern of what imports a file, given below the tree."""
    room = re.escape(".".join(file.parent.parts))
    return rf"from {room}(\.{file.stem} import| import .*\b{file.stem}\b)"


def kernels_of(file: Path) -> list[Path]:
    """Compiled kernels of a file."""
    return [
        p
        for end in ("nbi", "nbc")
        for p in (file.parent / "__pycache__").glob(f"{file.stem}.*.{end}")
    ]


def count_seen(words: list[str]) -> tuple[int, int]:
    """Bugs that were seen, and all that were planted."""
    wanted = [b for b in BUGS if not words or any(w in b.name for w in words)]
    found = 0
    with tempfile.TemporaryDirectory() as name:
        tree = Path(name) / "tree"
        skip = shutil.ignore_patterns(".git", ".venv", "bags", "docs", "out", "build", "install")
        shutil.copytree(ROOT, tree, ignore=skip)
        for bug in wanted:
            there = seen(bug, tree)
            found += there
            print(f"{'seen' if there else 'NOT SEEN'}: {bug.name}", flush=True)
    return found, len(wanted)


GOALS = {"seen by a test": (float(len(BUGS)), float(len(BUGS)))}


def run() -> dict[str, float | int | str]:
    """All of them."""
    found, planted = count_seen([])
    return {"planted bugs": planted, "seen by a test": found}


def main() -> int:
    """Plant, and say which were seen."""
    found, planted = count_seen(sys.argv[1:])
    print(f"{found} of {planted} seen")
    return int(found < planted)


if __name__ == "__main__":
    sys.exit(main())

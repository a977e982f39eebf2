"""Tests that belong together run in one process, and files in one each."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: Two files of one group, and one of none that the other process takes.
FILES = ("georeference/test_geodesy.py", "io/test_cdr.py", "model/test_verdict.py")


def test_a_group_is_one_process():
    command = [sys.executable, "-m", "pytest", "-n", "2", "-v", "-p", "no:cacheprovider"]
    done = subprocess.run(
        [*command, *(f"test/{file}" for file in FILES)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    found = set(re.findall(r"\[(gw\d)\].* PASSED test/(\S+?)::", done.stdout))
    workers = {file: {worker for worker, f in found if f == file} for file in FILES}
    assert workers[FILES[0]] == workers[FILES[1]] and len(workers[FILES[0]]) == 1
    assert len(workers[FILES[2]]) == 1 and workers[FILES[2]] != workers[FILES[0]]

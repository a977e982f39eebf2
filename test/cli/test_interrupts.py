"""Ctrl-C, which a terminal sends to a program and all its workers at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
from tiled_clouds import LEVEL, random, write


def interrupted(words: list[str]) -> tuple[int, str, list[psutil.Process]]:
    """Exit code and errors of a command that is interrupted when its two workers run, and what is
    left of its processes.
    """
    command = [sys.executable, "-m", "ladar_volume.cli.main", *words]
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    below: list[psutil.Process] = []
    while len(below) < 3 and process.poll() is None:  # with what keeps track of resources
        time.sleep(0.05)
        below = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=300)
    return process.returncode, errors, psutil.wait_procs(below, timeout=60)[1]


@pytest.mark.parametrize("verb", ["volume", "sites"])
def test_one_line_says_so_and_nothing_goes_on(verb, tmp_path):
    for k in range(3):
        write(tmp_path / f"cloud{k}.laz", random(100_000, np.random.default_rng(k)))
    if verb == "volume":
        pytest.importorskip("distributed")
        words = [str(tmp_path / "cloud0.laz"), "--dask"]
    else:
        words = [str(tmp_path), "-o", str(tmp_path / "table")]
    code, errors, left = interrupted([verb, *words, "--level", str(LEVEL), "--workers", "2"])
    lines = [line for line in errors.splitlines() if not line.startswith("dashboard ")]
    assert (code, lines, left) == (130, ["ladar_volume: interrupted"], [])

"""Mutated sensor messages: the counts of the node add up, by message and by return."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("seed", [1, 2])
def test_mutated_messages_end_nothing_and_every_one_is_accounted_for(seed):
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(os.getpid() % 90 + 10),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    command = [sys.executable, "-m", "benchmarks.fuzz", "--count", "900", "--seed", str(seed)]
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr + done.stdout
    seen = json.loads(done.stdout)
    assert not any(seen["missing"].values()) and seen["offered"] == {
        "fix": 600,
        "imu": 600,
        "cloud": 600,
    }
    assert seen["reasons"] > 15 and seen["taken"]["mapped"] > 0  # both ways were gone

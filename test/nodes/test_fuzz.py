"""Mutated sensor messages: the counts of the node add up, by message and by return."""

import json

import pytest
from own_process import printed_by


@pytest.mark.parametrize("seed", [1, 2])
def test_mutated_messages_end_nothing_and_every_one_is_accounted_for(seed):
    command = ("-m", "benchmarks.fuzz", "--count", 900, "--seed", seed)
    seen = json.loads(printed_by(*command, timeout_s=300))
    assert not any(seen["missing"].values()) and seen["offered"] == {
        "fix": 600,
        "imu": 600,
        "cloud": 600,
    }
    assert seen["reasons"] > 15 and seen["taken"]["mapped"] > 0  # both ways were gone

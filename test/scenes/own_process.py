"""Scripts that need a Python process of their own, in a ROS graph of their own."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def printed_by(*command, timeout_s=120, domain=0):
    """What ``python COMMAND`` prints in the project's folder; a failure shows what it said. The
    ROS domain is that of this process, moved on by ``domain``: tests that run at once do not hear
    each other.
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "test" / "scenes")]),
        "ROS_DOMAIN_ID": str((os.getpid() + domain) % 90 + 10),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def result_of(script, *arguments, **how):
    """The JSON that a script prints as its last line."""
    return json.loads(printed_by("-c", script, *arguments, **how).splitlines()[-1])

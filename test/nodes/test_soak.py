"""A short form of the soak: four nodes in four processes, faults one after the other, and the right
volume at the end.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAULTS = "restart_volume_node,nan,outage,fix_clock,lidar_stamps"


def test_a_flight_with_faults_ends_with_the_right_volume_and_balanced_books():
    environment = os.environ | {
        "ROS_DOMAIN_ID": str((os.getpid() + 9) % 90 + 10),
        "PYTHONPATH": str(ROOT),
    }
    command = [sys.executable, "-m", "benchmarks.soak", "--seconds", "45", "--faults", FAULTS]
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    seen = json.loads(done.stdout)
    assert seen["wrong"] == [] and set(seen["faults"]) == set(FAULTS.split(","))
    lost = seen["losses"]
    assert (
        lost["georeference_node fix_nan"] > 0
        and lost["georeference_node imu_nan"] > 0
        and lost["georeference_node point_nan"] > 0
    )
    assert lost["georeference_node fix_no_fix"] == seen["faults"]["outage"]
    assert (
        lost["georeference_node fix_time_backwards"] > 0
        and lost["georeference_node point_pose_timeout"] > 0
    )
    assert any("has no fix" in words for words in seen["named"])

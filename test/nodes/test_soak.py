"""A short form of the soak: four nodes in four processes, faults one after the other, and the right
volume at the end.
"""

import json

from own_process import printed_by

FAULTS = "restart_volume_node,nan,outage,fix_clock,lidar_stamps"


def test_a_flight_with_faults_ends_with_the_right_volume_and_balanced_books():
    command = ("-m", "benchmarks.soak", "--seconds", 30, "--faults", FAULTS)
    seen = json.loads(printed_by(*command, timeout_s=300))
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

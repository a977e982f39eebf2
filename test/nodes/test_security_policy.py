"""The policy of SROS2 names exactly the topics and services that the nodes use."""

import os
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_policy_is_that_of_the_nodes():
    environment = os.environ | {
        "ROS_DOMAIN_ID": str((os.getpid() + 33) % 90 + 10),
        "PYTHONPATH": str(ROOT),
    }
    done = subprocess.run(
        [sys.executable, "tools/sros2_policy.py", "--print"],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    kept = (ROOT / "config" / "sros2_policy.xml").read_text()
    assert done.stdout == kept, "run tools/sros2_policy.py"
    tree = ET.fromstring(kept)
    may = {
        (profile.get("node"), name.text)
        for profile in tree.iter("profile")
        for topics in profile.findall("topics")
        if topics.get("publish")
        for name in topics
    }
    assert {node for node, topic in may if topic == "/datum"} == {"georeference_node"}
    assert {node for node, topic in may if topic == "/points_mapped"} == {"georeference_node"}
    assert not [node for node, topic in may if topic == "/velodyne_points"]

"""The policy of SROS2 names exactly the topics and services that the nodes use."""

import xml.etree.ElementTree as ET

from own_process import ROOT, printed_by


def test_the_policy_is_that_of_the_nodes():
    printed = printed_by("tools/sros2_policy.py", "--print")
    kept = (ROOT / "config" / "sros2_policy.xml").read_text()
    assert printed == kept, "run tools/sros2_policy.py"
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

"""georeference_node sends once filter_node and volume_node listen and have found each other."""

from types import SimpleNamespace

import pytest

from ladar_volume.nodes.inputs.first_listeners import (
    ABSENT_S,
    JOINED,
    MOST_RETURNS,
    PRESENT_S,
    FirstListeners,
)


class Graph:
    """What the node sees of the graph."""

    def __init__(self, nodes=(), points=(), platform=(), joined=False, space="/rover"):
        self.nodes, self.space = nodes, space
        self.topics = {"/rover/points_mapped": points, "/rover/platform": platform}
        self.joined = joined

    def get_namespace(self):
        return "/rover"

    def resolve_topic_name(self, topic):
        return f"/rover/{topic}"

    def count_publishers(self, topic):
        return int(self.joined and topic == JOINED)

    def get_subscriptions_info_by_topic(self, topic):
        return [SimpleNamespace(node_name=n, node_namespace=self.space) for n in self.topics[topic]]

    def get_node_names_and_namespaces(self):
        return [(n, self.space) for n in self.nodes]


BOTH = ("filter_node", "volume_node")


def test_both_must_listen_and_have_found_each_other():
    graph = Graph(BOTH, ("filter_node",), BOTH)
    first = FirstListeners(graph)
    assert not first.all_there(5, 0.0) and not first.all_there(5, 10.0)
    graph.joined = True
    assert first.all_there(5, 10.1) and first.there
    graph.joined = False
    assert first.all_there(5, 11.0)  # what begins stays


@pytest.mark.parametrize("other", [Graph(BOTH, (), BOTH, True), Graph(BOTH, BOTH, BOTH[:1], True)])
def test_one_that_does_not_listen_yet_is_waited_for(other):
    first = FirstListeners(other)
    assert not first.all_there(5, 0.0) and not first.all_there(5, PRESENT_S - 1.0)
    assert first.all_there(5, PRESENT_S + 1.0)


@pytest.mark.parametrize("alone", [Graph(("filter_node",)), Graph(BOTH, space="/other")])
def test_nodes_that_are_not_there_are_not_waited_for_long(alone):
    first = FirstListeners(alone)
    assert not first.all_there(5, 100.0) and not first.all_there(5, 100.0 + ABSENT_S)
    assert first.all_there(5, 100.1 + ABSENT_S)


def test_what_waits_is_bounded():
    first = FirstListeners(Graph(BOTH))
    assert not first.all_there(MOST_RETURNS, 0.0) and first.all_there(MOST_RETURNS + 1, 0.0)

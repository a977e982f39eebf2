"""Graphs that run at the same time, of one process or of several, have domains of their own."""

import contextlib
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from ladar_volume.process import private_graph as room
from ladar_volume.process.private_graph import private_graph

ROOT = Path(__file__).parents[2]
HELD = """
import sys
from ladar_volume.process.private_graph import private_graph
with private_graph(first=15) as graph:
    print(graph["ROS_DOMAIN_ID"], flush=True)
    sys.stdin.readline()
"""


def domain_of(graph):
    return int(graph["ROS_DOMAIN_ID"])


def test_processes_that_begin_with_the_same_domain_get_different_ones():
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": ROOT}
    holders = [subprocess.Popen([sys.executable, "-c", HELD], **pipes) for _ in range(4)]
    try:
        domains = {int(holder.stdout.readline()) for holder in holders}
    finally:
        for holder in holders:
            holder.kill()
            holder.communicate()
    assert len(domains) == 4 and domains <= set(room.DOMAINS)


def test_a_domain_is_free_again_and_the_next_graph_of_a_process_has_another():
    with private_graph() as first:
        taken = domain_of(first)
        with private_graph(first=taken) as second:
            assert domain_of(second) != taken
    with private_graph(first=taken) as again:
        assert domain_of(again) == taken


def test_the_domain_of_a_strangers_graph_is_left_alone():
    with private_graph() as graph:
        domain = domain_of(graph)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("", room.FIRST_PORT + room.PORTS * domain))
        with private_graph(first=domain) as other:
            assert domain_of(other) != domain


def test_no_domain_left_is_an_error_with_what_to_do(monkeypatch):
    with private_graph() as graph, contextlib.ExitStack() as stack:
        monkeypatch.setattr(room, "DOMAINS", range(domain_of(graph), domain_of(graph) + 1))
        with pytest.raises(OSError, match="set ROS_DOMAIN_ID"):
            stack.enter_context(private_graph())

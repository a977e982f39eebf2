"""A ROS graph that is one program's own: on the loopback, in a domain that no other program of this
package on the computer has at the same time.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from collections.abc import Iterator

#: Domains to choose from. The DDS ports of later ones lie among those that the system hands out.
DOMAINS = range(10, 100)
#: Port of the first program of domain 0, and ports of each domain (the rules of DDS).
FIRST_PORT, PORTS = 7410, 250
LOOPBACK = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

_last = [os.getpid()]
_joined = contextlib.ExitStack()


@contextlib.contextmanager
def private_graph(first: int | None = None) -> Iterator[dict[str, str]]:
    """The environment variables of a graph of its own, for this process or for those that it
    starts. Its domain is taken until the block ends, however the process ends; the next graph of
    this process gets another one. first : the domain that is tried first. Raises OSError where all
    are taken.
    """
    if first is not None:
        _last[0] = DOMAINS.index(first) - 1
    domain, held = _take_domain()
    with held:
        yield {"ROS_DOMAIN_ID": str(domain)} | LOOPBACK


def join_private_graph() -> None:
    """Put this process, and those that it starts, into a graph of its own until it ends. What the
    user has set stays.
    """
    if "ROS_DOMAIN_ID" in os.environ:
        graph = LOOPBACK
    else:
        graph = _joined.enter_context(private_graph())
    for name, value in graph.items():
        os.environ.setdefault(name, value)


def _take_domain() -> tuple[int, socket.socket]:
    """A domain, and what holds it until it is closed."""
    for _ in DOMAINS:
        _last[0] += 1
        domain = DOMAINS[_last[0] % len(DOMAINS)]
        held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # an abstract name is no file: it goes with the process, and other users see it, too
        if _bound(held, f"\0ladar_volume/ros_domain/{domain}"):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as first:
                if _bound(first, ("", FIRST_PORT + PORTS * domain)):  # no graph of others either
                    return domain, held
        held.close()
    raise OSError(errno.EADDRINUSE, "ROS domains 10 to 99 are all in use: set ROS_DOMAIN_ID")


def _bound(one: socket.socket, address: str | tuple[str, int]) -> bool:
    try:
        one.bind(address)
    except OSError:
        return False
    return True

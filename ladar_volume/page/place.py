"""Addresses that are given on the command line, to serve something at."""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass

from ladar_volume.model.errors import ConfigurationError


@dataclass(frozen=True)
class Place:
    """Where something is served; own : whether this computer alone reaches it."""

    host: str
    port: int
    own: bool


def place_of(text: str, option: str) -> Place:
    """``PORT``, ``HOST:PORT`` or ``[HOST]:PORT`` with an IP address as host; loopback where there
    is none. Raises :class:`ConfigurationError`.
    """
    host, _, port = text.rpartition(":")
    host = host.strip("[]") or "127.0.0.1"
    try:
        number, ip = int(port), ipaddress.ip_address(host)
    except ValueError as error:
        raise ConfigurationError(
            f"{option} {text}: PORT, or ADDRESS:PORT with an IP address", value=text
        ) from error
    if not 0 <= number < 65536:
        raise ConfigurationError(f"{option} {text}: a port is from 0 to 65535", value=text)
    return Place(host, number, ip.is_loopback)

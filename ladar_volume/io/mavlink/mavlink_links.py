"""Where MAVLink bytes come from: UDP, TCP or a serial port. A socket listens on the one address it
is given, and on loopback where none is given; it talks to one peer at a time.

A socket that listens is bound to the first peer. Where that is silent, another port of the same
host may speak for it (an autopilot that started again), until the first one is back. Other hosts
are counted and left out until the node is reset.
"""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import termios
import time
import tty
from typing import Protocol

from ladar_volume.model.errors import ConfigurationError, short_repr
from ladar_volume.model.losses import Losses

#: A peer that is silent for this long may be replaced by another port of its host.
PEER_S = 5.0
#: A lost connection is tried again after this time.
RETRY_S = 1.0
#: What a bad address raises: also names that are none, and zero bytes.
_ADDRESS = (OSError, UnicodeError, ValueError, OverflowError, TypeError)


class Link(Protocol):
    """A two-way link. ``losses`` counts what was refused and how often the link broke."""

    losses: Losses

    @property
    def is_open(self) -> bool:
        """Whether the own end is there: a port of this computer that could be taken."""

    def read(self, timeout_s: float) -> bytes:
        """What has come, at most ``timeout_s`` from now; empty for nothing."""

    def write(self, data: bytes) -> None:
        """Send; what the link cannot take now is lost, as on the wire."""

    def forget(self) -> None:
        """Forget the peer: the next one that speaks is bound."""

    def close(self) -> None:
        """Let go."""


class Peers:
    """Who may speak on a socket that listens."""

    def __init__(self, losses: Losses) -> None:
        self._losses = losses
        self.first: tuple[str, int] | None = None
        self.now: tuple[str, int] | None = None
        self._heard = 0.0

    def admits(self, sender: tuple[str, int], now_s: float) -> bool:
        """Whether to listen to a sender at a time (s, of a steady clock)."""
        first = self.first = self.first or sender
        silent = now_s - self._heard >= PEER_S
        if sender not in (first, self.now) and (sender[0] != first[0] or not silent):
            self._losses.add("mavlink_other_peer")
            return False
        if sender != self.now and self.now is not None:
            self._losses.add("mavlink_peer_changed")
        self.now, self._heard = sender, now_s
        return True


def _read_available(descriptor: int, timeout_s: float) -> bytes | None:
    """What has come within ``timeout_s``, empty for nothing, None where the other end is gone."""
    ready, _, _ = select.select([descriptor], [], [], timeout_s)
    if not ready:
        return b""
    try:
        return os.read(descriptor, 65535) or None
    except BlockingIOError:
        return b""
    except OSError:
        return None


class UdpLink:
    """Datagrams: listening on ``address``, or sending to it. A port that another program holds is
    tried again every :data:`RETRY_S`, and counted.
    """

    def __init__(self, address: tuple[str, int], listen: bool) -> None:
        self.losses = Losses()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peers = Peers(self.losses) if listen else None
        self._wanted: tuple[str, int] | None = None
        self.next_attempt = 0.0
        try:
            if listen:
                self._bind(address)
            else:
                self._socket.connect(address)
        except _ADDRESS as error:
            self._socket.close()
            raise ConfigurationError(
                f"mavlink.url: {short_repr(address[0])}:{address[1]}: {error}", value=address
            ) from error
        self._socket.setblocking(False)

    @property
    def is_open(self) -> bool:
        """Whether the port is bound."""
        return self._wanted is None

    def _bind(self, address: tuple[str, int]) -> None:
        """Listen, or remember to try again."""
        try:
            self._socket.bind(address)
            self._wanted = None
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            self._wanted, self.next_attempt = address, time.monotonic() + RETRY_S
            self.losses.add("mavlink_port_not_open")

    @property
    def address(self) -> tuple[str, int]:
        """The own end."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    def read(self, timeout_s: float) -> bytes:
        """All datagrams of the peer that wait; those of others are counted and dropped."""
        if self._wanted is not None:
            time.sleep(min(timeout_s, max(self.next_attempt - time.monotonic(), 0.0)))
            if time.monotonic() >= self.next_attempt:
                self._bind(self._wanted)
            return b""
        select.select([self._socket], [], [], timeout_s)
        data = bytearray()
        with contextlib.suppress(OSError):  # nothing more waits, or the peer's port is closed
            while len(data) < 1 << 20:
                packet, sender = self._socket.recvfrom(65535)
                if self._peers is None or self._peers.admits(sender, time.monotonic()):
                    data += packet
        return bytes(data)

    def write(self, data: bytes) -> None:
        """To the peer, once there is one."""
        with contextlib.suppress(OSError):
            if self._peers is None:
                self._socket.send(data)
            elif self._peers.now is not None:
                self._socket.sendto(data, self._peers.now)

    def forget(self) -> None:
        """The next sender is bound."""
        if self._peers is not None:
            self._peers = Peers(self.losses)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpLink:
    """A connection: accepted one at a time on ``address``, or made to it and made again when it
    breaks.
    """

    def __init__(self, address: tuple[str, int], listen: bool) -> None:
        self.losses = Losses()
        self._address = address
        self._peer: socket.socket | None = None
        self._server: socket.socket | None = None
        self.host: str | None = None
        self.next_attempt = 0.0
        if listen:
            try:
                self._server = socket.create_server(address, backlog=1)
            except _ADDRESS as error:
                raise ConfigurationError(
                    f"mavlink.url: {short_repr(address[0])}:{address[1]}: {error}", value=address
                ) from error
            self._server.setblocking(False)

    @property
    def is_open(self) -> bool:
        """Whether it listens or is connected; to what it listens, the other end connects."""
        return self._server is not None or self._peer is not None

    @property
    def address(self) -> tuple[str, int]:
        """The address that listens or is connected to."""
        if self._server is None:
            return self._address
        host, port = self._server.getsockname()[:2]
        return str(host), int(port)

    def _connect(self, timeout_s: float) -> None:
        with contextlib.suppress(*_ADDRESS):
            if self._server is not None:
                select.select([self._server], [], [], timeout_s)
                peer, sender = self._server.accept()
                self.host = self.host or str(sender[0])
                if self.host != sender[0]:
                    self.losses.add("mavlink_other_peer")
                    peer.close()
                    return
                self._peer = peer
            elif time.monotonic() >= self.next_attempt:
                self.next_attempt = time.monotonic() + RETRY_S
                self._peer = socket.create_connection(self._address, timeout=RETRY_S)
            else:
                time.sleep(min(timeout_s, max(self.next_attempt - time.monotonic(), 0.0)))
        if self._peer is not None:
            self._peer.setblocking(False)
            self._peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def drop(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None
            self.losses.add("mavlink_link_lost")

    def read(self, timeout_s: float) -> bytes:
        """What has come; connects where nobody is connected."""
        if self._peer is None:
            self._connect(timeout_s)
            return b""
        data = _read_available(self._peer.fileno(), timeout_s)
        if data is None:
            self.drop()
        return data or b""

    def write(self, data: bytes) -> None:
        """To whoever is connected."""
        if self._peer is not None:
            try:
                self._peer.send(data)
            except BlockingIOError:
                return
            except OSError:
                self.drop()

    def forget(self) -> None:
        """The next host that connects is bound."""
        self.host = None

    def close(self) -> None:
        """Close everything."""
        for end in (self._peer, self._server):
            if end is not None:
                end.close()


class SerialLink:
    """A serial port, raw, 8N1; opened again when it goes away."""

    def __init__(self, device: str, baud: int) -> None:
        self.losses = Losses()
        self._device, self.next_attempt = device, 0.0
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise ConfigurationError(
                f"mavlink.url: {baud} is no baud rate of this system", value=baud
            )
        self._speed: int = speed
        self._fd: int | None = None
        self._open()

    @property
    def is_open(self) -> bool:
        """Whether the device is open."""
        return self._fd is not None

    def _open(self) -> None:
        self.next_attempt = time.monotonic() + RETRY_S
        fd = None
        try:
            fd = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(fd)
            settings = termios.tcgetattr(fd)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = self._speed
            termios.tcsetattr(fd, termios.TCSANOW, settings)
        except (OSError, termios.error):
            if fd is not None:
                os.close(fd)
            self.losses.add("mavlink_port_not_open")
            return
        self._fd = fd

    def drop(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None
            self.losses.add("mavlink_link_lost")

    def read(self, timeout_s: float) -> bytes:
        """What has come."""
        if self._fd is None:
            time.sleep(min(timeout_s, max(self.next_attempt - time.monotonic(), 0.0)))
            if time.monotonic() >= self.next_attempt:
                self._open()
            return b""
        data = _read_available(self._fd, timeout_s)
        if data is None:
            self.drop()
        return data or b""

    def write(self, data: bytes) -> None:
        """To the port."""
        if self._fd is not None:
            with contextlib.suppress(OSError):
                os.write(self._fd, data)

    def forget(self) -> None:
        """There is one other end."""

    def close(self) -> None:
        """Close the port."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None


def open_link(url: str) -> Link:
    """A link for ``udpin:HOST:PORT`` and the others. Raises ConfigurationError naming what is
    wrong.
    """
    scheme, _, rest = url.partition(":")
    host, _, number = rest.rpartition(":")
    most = 10_000_000 if scheme == "serial" else 65535
    digits = number.isascii() and number.isdigit() and len(number) < 10
    if scheme.startswith("/dev/"):
        words = f"mavlink.url: {short_repr(url)}: a port is given as serial:{scheme}:57600"
        raise ConfigurationError(words, value=url)
    if not digits or int(number) > most:
        raise ConfigurationError(
            f"mavlink.url: {short_repr(url)}: the number after the last colon is missing or too "
            "large",
            value=url,
        )
    if scheme == "serial":
        return SerialLink(host, int(number))
    address = (host or "127.0.0.1", int(number))
    if scheme in ("udpin", "udpout"):
        return UdpLink(address, scheme == "udpin")
    if scheme in ("tcp", "tcpin"):
        return TcpLink(address, scheme == "tcpin")
    raise ConfigurationError(
        f"mavlink.url: {short_repr(url)}: one of udpin, udpout, tcp, tcpin, serial, or a .tlog or "
        ".bin file",
        value=url,
    )

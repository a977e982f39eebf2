"""Bytes to MAVLink messages: pymavlink parses and checks, this finds back into the stream after
noise and keeps the account.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from ladar_volume.io.mavlink.mavlink_signing import is_signed
from ladar_volume.model.losses import Losses

MARKERS = (0xFE, 0xFD)
#: Why pymavlink refuses a packet that is whole and not signed as it must be.
SIGNATURE = "Invalid signature"
#: Sequence numbers further ahead than this are late packets, not a gap.
HALF = 128


def frame_is_good(frame: bytes) -> bool:
    """Whether a frame's message is known and its checksum fits."""
    v2 = frame[0] == 0xFD
    number = int.from_bytes(frame[7:10], "little") if v2 else frame[5]
    message = dialect.mavlink_map.get(number)
    if message is None:
        return False
    end = (10 if v2 else 6) + frame[1]
    crc = dialect.x25crc(frame[1:end] + bytes([message.crc_extra])).crc
    return bool(crc == int.from_bytes(frame[end : end + 2], "little"))


class MavlinkStream:
    """One direction in, one out. ``losses`` counts bytes of noise, packets that never came and
    packets that came twice.
    """

    def __init__(
        self, accepts: Callable[[int, int], bool], own_system: int, own_component: int
    ) -> None:
        self.losses = Losses()
        self.packets = 0
        self._accepts = accepts
        self.incoming = dialect.MAVLink(None)
        self.incoming.robust_parsing = True
        self._sequence: dict[tuple[int, int], int] = {}
        self._collected = bytearray()
        self.out = dialect.MAVLink(self, srcSystem=own_system, srcComponent=own_component)

    def sign(self, key: bytes, now_10us: int) -> None:
        """From now on sign what goes out, and refuse what comes unsigned or wrongly signed.
        now_10us : in units of signatures.
        """
        for end in (self.incoming, self.out):
            end.signing.secret_key = key
            end.signing.timestamp = max(end.signing.timestamp, now_10us)
        self.out.signing.sign_outgoing = True
        # pymavlink takes over the time of a packet before it looks at the signature: a forged one
        # would shut out all that follow
        usual = self.incoming.check_signature
        self.incoming.check_signature = lambda packet, system, component: (
            is_signed(bytes(packet), key) and usual(packet, system, component)
        )

    @property
    def is_signed(self) -> bool:
        """Whether packets are signed."""
        return self.incoming.signing.secret_key is not None

    def write(self, data: bytes) -> None:
        """Where pymavlink puts packed messages."""
        self._collected += data

    def take_outgoing(self) -> bytes:
        """What is to be sent."""
        data, self._collected = bytes(self._collected), bytearray()
        return data

    def forget_sequence(self) -> None:
        """The sender restarted: its numbers begin anew."""
        self._sequence = {}

    def feed(self, data: bytes) -> list[Any]:
        """The messages that became whole, those of other senders included."""
        parser, found = self.incoming, []
        parser.buf.extend(data)
        while True:
            try:
                message = parser.parse_char(b"")
            except Exception:  # a defect of the parser on hostile input must not end the stream
                self.losses.add("mavlink_parser_error")
                parser.buf, parser.buf_index = parser.buf[parser.buf_index + 1 :], 0
                continue
            if message is None:
                break
            if self.is_noise(message):
                continue
            self.packets += 1
            if self._in_order(message):
                found.append(message)
        if parser.buf_index:  # pymavlink frees its buffer only when it happens to be empty
            parser.buf, parser.buf_index = parser.buf[parser.buf_index :], 0
        return found

    def is_noise(self, message: Any) -> bool:
        kind = message.get_type()
        if kind == "BAD_DATA":
            data = bytes(message.data)
            if self.is_signed and str(message.reason) == SIGNATURE:
                self.losses.add("mavlink_signature_refused")
                return True
        elif kind.startswith(
            "UNKNOWN"
        ):  # no checksum can be verified: only the vehicle itself may send such
            data = bytes(message.get_msgbuf())
            system, component = (data[5], data[6]) if data[0] == 0xFD else (data[3], data[4])
            if self._accepts(system, component):
                self.losses.add("mavlink_unknown_message")
                self._count_sequence(system, component, data[4] if data[0] == 0xFD else data[2])
                return True
        elif message.get_msgbuf()[0] == 0xFE and message.get_header().mlen > message.unpacker.size:
            data = bytes(
                message.get_msgbuf()
            )  # version 1 knows no longer messages: its checksum fits by chance
        else:
            return False
        lost = len(data)
        if data[:1] and data[0] in MARKERS and lost > 1:
            # only the marker is known to be wrong: a good packet may begin inside
            parser = self.incoming
            parser.buf, parser.buf_index = bytearray(data[1:]) + parser.buf[parser.buf_index :], 0
            lost = 1
        self.losses.add("mavlink_noise_byte", lost)
        return True

    def _in_order(self, message: Any) -> bool:
        header = message.get_header()
        return self._count_sequence(header.srcSystem, header.srcComponent, header.seq)

    def _count_sequence(self, system: int, component: int, sequence: int) -> bool:
        """Whether this packet is new; counts those missing before it."""
        if not self._accepts(system, component):
            return True
        last = self._sequence.get((system, component))
        ahead = 1 if last is None else (sequence - last) % 256
        if ahead == 0:
            self.losses.add("mavlink_packet_twice")
            return False
        if ahead < HALF:
            self.losses.add("mavlink_packet_lost", ahead - 1)
            self._sequence[system, component] = sequence
        else:
            self.losses.add("mavlink_packet_late")
        return True

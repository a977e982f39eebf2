"""A conversation with an autopilot: bytes in, records out, and what is asked of it. Knows no
sockets and no clock but what it is told.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from ladar_volume.io.mavlink.mavlink_clock import S
from ladar_volume.io.mavlink.mavlink_records import FIX_NAMES, MavlinkDecoder, Record
from ladar_volume.io.mavlink.mavlink_signing import signature_time, signing_key
from ladar_volume.io.mavlink.mavlink_stream import MavlinkStream
from ladar_volume.model.losses import Losses
from ladar_volume.model.mavlink_parameters import MavlinkParameters

COMPONENT = dialect.MAV_COMP_ID_ONBOARD_COMPUTER
#: A rate is asked for again when nothing of that kind came for this long.
ASK_AGAIN_NS = 5 * S
#: An answer to TIMESYNC later than this is of no use.
ROUND_TRIP_NS = S


class MavlinkSession:
    """Feed it bytes with their time of receipt, send what :meth:`due` gives."""

    def __init__(self, parameters: MavlinkParameters) -> None:
        """Raises ConfigurationError for a key of signing that is none."""
        self.parameters = parameters
        self._key = signing_key(parameters.signing_key_file)
        self.decoder = MavlinkDecoder(parameters)
        self.stream = MavlinkStream(self.decoder.accepts, parameters.system or 255, COMPONENT)
        self.alive = False
        self.own = Losses()
        self._restarts = 0
        self._heartbeat_ns: int | None = None
        self._spoken_ns: int | None = None
        self._asked: dict[int, tuple[int, int]] = {}
        self._sent: dict[int, int] = {}

    def feed(self, data: bytes, received_ns: int) -> list[Record]:
        """Bytes that came together. Never raises for what they hold."""
        self._sign(received_ns)
        records = []
        for message in self.stream.feed(data):
            record = self.decoder.take(message, received_ns)
            if record is not None:
                records.append(record)
            if self.decoder.accepts(message.get_srcSystem(), message.get_srcComponent()):
                self._listen(message, received_ns)
        if self.decoder.restarts != self._restarts:
            self._restarts, self._asked = self.decoder.restarts, {}
            self.stream.forget_sequence()
        self._watch(received_ns)
        return records

    def _sign(self, now_ns: int) -> None:
        """Begin to sign, once the time is known."""
        if self._key is not None and not self.stream.is_signed:
            self.stream.sign(self._key, signature_time(now_ns))

    def _listen(self, message: Any, received_ns: int) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._heartbeat_ns = received_ns
            if not self.alive:
                self.alive, self._asked = True, {}
        elif kind == "TIMESYNC" and message.tc1 > 0:
            sent = self._sent.pop(
                message.ts1, None
            )  # the answer to somebody else's question says nothing
            if sent is not None and 0 <= received_ns - sent < ROUND_TRIP_NS:
                self.decoder.round_trip(sent, message.tc1, received_ns)
        elif kind == "COMMAND_ACK" and message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
            if message.result not in (dialect.MAV_RESULT_ACCEPTED, dialect.MAV_RESULT_IN_PROGRESS):
                self.own.add("mavlink_rate_refused")

    def _watch(self, now_ns: int) -> None:
        timeout = self.parameters.heartbeat_timeout_s * 1e9
        if self.alive and self._heartbeat_ns is not None and now_ns - self._heartbeat_ns > timeout:
            self.alive = False
            self.own.add("mavlink_heartbeat_lost")

    def due(self, now_ns: int) -> bytes:
        """What is to be sent now: the own heartbeat and a TIMESYNC once a second, requests for
        rates as long as they are needed.
        """
        self._watch(now_ns)
        self._sign(now_ns)
        out = self.stream.out
        if self._spoken_ns is None or not 0 <= now_ns - self._spoken_ns < S:
            self._spoken_ns = now_ns
            out.heartbeat_send(
                dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                dialect.MAV_AUTOPILOT_INVALID,
                0,
                0,
                dialect.MAV_STATE_ACTIVE,
            )
            if self.alive:
                self._sent = {k: v for k, v in self._sent.items() if now_ns - v < ROUND_TRIP_NS} | {
                    now_ns: now_ns
                }
                out.timesync_send(0, now_ns)
        if self.alive:
            for number, hz in self._requested_rates().items():
                self._ask(number, hz, now_ns)
        return self.stream.take_outgoing()

    def _requested_rates(self) -> dict[int, float]:
        """Message number → rate."""
        p = self.parameters
        number = {
            "GPS_RAW_INT": 24,
            "GPS2_RAW": 124,
            "GLOBAL_POSITION_INT": 33,
            "ATTITUDE": 30,
            "ATTITUDE_QUATERNION": 31,
            "auto": 31,
        }
        wanted = {number[p.position]: p.position_hz, number[p.attitude]: p.attitude_hz, 2: 1.0}
        if p.position == "GLOBAL_POSITION_INT" and p.height != "msl":
            wanted[24] = min(
                1.0, p.position_hz
            )  # the height of the ellipsoid is in the receiver's message alone
        wanted[27 if self.decoder.ardupilot else 105] = p.imu_hz
        wanted[331] = p.odometry_hz
        return {k: hz for k, hz in wanted.items() if hz > 0}

    def _ask(self, number: int, hz: float, now_ns: int) -> None:
        kind = dialect.mavlink_map[number].msgname
        count = self.decoder.counts.get(kind, 0)
        asked, before = self._asked.get(number, (None, 0))
        if asked is not None and 0 <= now_ns - asked < ASK_AGAIN_NS:
            return
        self._asked[number] = (now_ns, count)
        if asked is not None and count > before:
            return  # it comes
        self.stream.out.command_long_send(
            self.decoder.system,
            self.parameters.component,
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
            0,
            number,
            1e6 / hz,
            0,
            0,
            0,
            0,
            0,
        )

    def losses(self) -> Losses:
        """Everything refused, missing or broken, by reason."""
        total = Losses(self.own.as_dict())
        total.merge(self.stream.losses)
        total.merge(self.decoder.losses)
        total.add("mavlink_restart", self.decoder.restarts)
        return total

    def status(self) -> dict[str, Any]:
        """The link in a few lines."""
        d = self.decoder
        line = d.clock.line
        fix = FIX_NAMES[d.fix_type] if d.fix_type < len(FIX_NAMES) else str(d.fix_type)
        return {
            "autopilot": "alive" if self.alive else "no heartbeat",
            "system": d.system,
            "signing": "signed" if self._key is not None else "none",
            "packets": self.stream.packets,
            "fix_type": fix,
            "satellites": d.satellites,
            "fixes_repeated": d.repeated,
            "height": d.heights.reference or "no fix yet",
            "clock": self.clock_name(),
            "clock_offset_s": "unknown"
            if line is None
            else f"{line.offset(line.at_ns) * 1e-9:.6f}",
            "clock_drift_ppm": "unknown" if line is None else f"{line.drift * 1e6:.1f}",
            "clock_sigma_s": "unknown" if line is None else f"{line.sigma_ns * 1e-9:.6f}",
            **{f"received_{kind}": n for kind, n in sorted(d.counts.items())},
        }

    def clock_name(self) -> str:
        """What the stamps rest on."""
        if self.parameters.clock == "utc":
            return "UTC by SYSTEM_TIME"
        return "round trips of TIMESYNC" if self.decoder.round_trips.ready else "times of arrival"

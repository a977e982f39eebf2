"""MAVLink 2 signing: the packets of a session with a key are signed, and only such are taken."""

import os

import pytest
from pymavlink.dialects.v20 import all as dialect

from ladar_volume.io.mavlink.mavlink_session import MavlinkSession
from ladar_volume.io.mavlink.mavlink_signing import EPOCH_NS, signature_time, signing_key
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.mavlink_parameters import MavlinkParameters

KEY = bytes(range(1, 33))
NOW = EPOCH_NS + 350_000_000 * 10**9


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    return path


class Autopilot:
    """The vehicle's end of a link, with pymavlink's own signing."""

    def __init__(self, key=KEY, ahead=0):
        self.sent = bytearray()
        self.link = dialect.MAVLink(self, srcSystem=1, srcComponent=1)
        self.link.robust_parsing = True
        if key is not None:
            self.link.signing.secret_key, self.link.signing.sign_outgoing = key, True
            self.link.signing.timestamp = signature_time(NOW) + ahead

    def write(self, data):
        self.sent += data

    def heartbeat(self):
        self.sent.clear()
        self.link.heartbeat_send(2, dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4)
        return bytes(self.sent)


def session(path):
    return MavlinkSession(MavlinkParameters(signing_key_file=str(path) if path else ""))


def refused(found):
    return found.losses().as_dict().get("mavlink_signature_refused", 0)


def test_signed_packets_go_both_ways(key_file):
    own, vehicle = session(key_file), Autopilot()
    own.feed(vehicle.heartbeat(), NOW)
    assert own.alive and refused(own) == 0 and own.status()["signing"] == "signed"
    heard = vehicle.link.parse_buffer(own.due(NOW))
    assert [m.get_type() for m in heard][:2] == ["HEARTBEAT", "TIMESYNC"]
    assert {m.get_type() for m in heard} == {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG"}
    assert vehicle.link.signing.goodsig_count == len(heard)


@pytest.mark.parametrize("key", [None, bytes(32), bytes(range(2, 34))])
def test_packets_without_the_key_are_refused_and_counted(key_file, key):
    own, vehicle = session(key_file), Autopilot(key)
    own.feed(b"".join(vehicle.heartbeat() for _ in range(3)), NOW)
    assert not own.alive and refused(own) == 3
    assert "mavlink_noise_byte" not in own.losses().as_dict()


def test_a_packet_is_taken_once_and_a_forged_time_shuts_nobody_out(key_file):
    own, vehicle = session(key_file), Autopilot()
    first = vehicle.heartbeat()
    own.feed(first, NOW)
    own.feed(first, NOW)
    assert refused(own) == 1
    forged = Autopilot(bytes(range(2, 34)), ahead=10**12).heartbeat()
    own.feed(forged, NOW)
    own.feed(vehicle.heartbeat(), NOW)
    assert refused(own) == 2 and own.decoder.counts["HEARTBEAT"] == 2


def test_without_a_key_nothing_is_signed_and_signed_packets_are_read():
    own, vehicle = session(None), Autopilot()
    own.feed(vehicle.heartbeat(), NOW)
    assert own.alive and not own.due(NOW)[2] & 1 and own.status()["signing"] == "none"


def test_a_key_that_is_none_or_open_to_others_is_refused(tmp_path, key_file):
    assert signing_key(str(key_file)) == KEY and signing_key("") is None
    os.chmod(key_file, 0o644)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        signing_key(str(key_file))
    for text in ("", "00" * 32, "ab" * 31, "zz" * 32):
        key_file.write_text(text)
        key_file.chmod(0o600)
        with pytest.raises(ConfigurationError, match="64 hexadecimal digits"):
            signing_key(str(key_file))
    with pytest.raises(ConfigurationError, match="No such file"):
        session(tmp_path / "none")

"""MAVLink 2 signing: the key of a link from its file, and the clock of signatures.

A signature holds a time in units of 10 us since 2015 that only grows: a packet that was heard
before is refused (https://mavlink.io/en/guide/message_signing.html).
"""

from __future__ import annotations

import hashlib
import hmac
import os
import stat
from pathlib import Path

from ladar_volume.model.errors import ConfigurationError

#: Bytes of a key; its hexadecimal digits, and what else the file may hold.
KEY, SPACE = 32, 1000
#: 1 January 2015 UTC, ns since 1970.
EPOCH_NS = 1_420_070_400 * 10**9
#: Unit of a signature's time, ns.
UNIT_NS = 10_000
#: Rights of others to the file.
OTHERS = stat.S_IRWXG | stat.S_IRWXO


def signing_key(path: str) -> bytes | None:
    """The key (32 bytes) in a file, None without a file. Raises ConfigurationError for what cannot
    be read, is no key, or is open to other users.
    """
    if not path:
        return None
    name = "mavlink.signing_key_file"
    try:
        with open(path, "rb") as file:
            if os.fstat(file.fileno()).st_mode & OTHERS:
                raise ConfigurationError(
                    f"{name}: {path} is open to other users: chmod 600", value=path
                )
            text = file.read(SPACE)
    except OSError as error:
        raise ConfigurationError(f"{name}: {error}", value=path) from error
    try:
        key = bytes.fromhex(text.decode("ascii").strip())
    except (UnicodeDecodeError, ValueError):
        key = b""
    if len(key) != KEY or not any(key):
        raise ConfigurationError(
            f"{name}: {Path(path).name} must hold 64 hexadecimal digits, not all zero, and nothing "
            "else",
            value=path,
        )
    return key


def signature_time(now_ns: int) -> int:
    """The time (ns since 1970) in the units of signatures."""
    return max(now_ns - EPOCH_NS, 0) // UNIT_NS


def is_signed(packet: bytes, key: bytes) -> bool:
    """Whether the last six bytes of a packet are its signature: the first of SHA-256 over the key
    and what is before them.
    """
    return hmac.compare_digest(hashlib.sha256(key + packet[:-6]).digest()[:6], packet[-6:])

"""The flight log over days: numbered files, a disk that fills up, and an account of every message.
It never raises for the disk's sake: what cannot be written is counted by topic and reason.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import stat
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import zstandard
from mcap.writer import MCAP0_MAGIC

from ladar_volume.io.mcap_log import LIBRARY, McapLog, usual_definition
from ladar_volume.io.mcap_recovery import Recovery, is_complete, recover
from ladar_volume.model.errors import ConfigurationError, OutputError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import LoggerParameters

#: A full disk is looked at again after this time.
RETRY_S = 1.0
#: Magic, profile and library of an MCAP stand within its first bytes.
_HEADER_BYTES = 128


@dataclass
class TopicAccount:
    """Messages of one topic: written to the disk; lost by the middleware, by a full queue, by the
    disk; published before the log listened; bytes offered; of those written, copies of what the log
    did not hear itself.
    """

    written: int = 0
    before: int = 0
    middleware: int = 0
    queue: int = 0
    disk: int = 0
    bytes: int = 0
    copied: int = 0


def free_bytes(folder: Path) -> int:
    """What the disk that holds, or will hold, a folder has left for us."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return shutil.disk_usage(folder).free


def log_files(base: Path) -> list[Path]:
    """The files of a log, in the order of their running number: ``log.mcap``, ``log_1.mcap``,
    ...
    """
    pattern = re.compile(rf"{re.escape(base.stem)}(?:_(\d+))?{re.escape(base.suffix)}")
    found = [
        (int(m[1] or 0), p)
        for p in base.parent.glob(f"{base.stem}*{base.suffix}")
        if (m := pattern.fullmatch(p.name))
    ]
    return [p for _, p in sorted(found)]


class WrittenFiles:
    """The names of the files that this log wrote, kept beside it as ``.log.mcap.written``: nothing
    else is ever deleted.
    """

    def __init__(self, base: Path) -> None:
        self._path = base.with_name(f".{base.name}.written")

    def add(self, path: Path) -> None:
        """Note a file that was just begun. Where that fails, it is never deleted."""
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK
        with contextlib.suppress(OSError):
            with open(os.open(self._path, flags, 0o644), "a", encoding="utf-8") as manifest:
                manifest.write(f"{path.name}\n")

    def holds(self, path: Path) -> bool:
        """Whether a file is in the list, no link, and an MCAP that this library began."""
        try:
            with open(_regular(self._path), encoding="utf-8") as manifest:
                if path.name not in manifest.read().splitlines():
                    return False
            with open(_regular(path), "rb") as file:
                start = file.read(_HEADER_BYTES)
        except (OSError, UnicodeDecodeError):
            return False
        return start.startswith(MCAP0_MAGIC) and LIBRARY.encode() in start


def _regular(path: Path) -> int:
    """A descriptor to read a regular file; OSError for links, pipes and devices."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(f"{path} is not a regular file")
    return descriptor


class Recorder:
    """Writes one log, split over as many files as it takes. Not thread-safe: one writer thread."""

    def __init__(
        self,
        parameters: LoggerParameters,
        definition: Callable[[str], str] = usual_definition,
        free: Callable[[Path], int] = free_bytes,
    ) -> None:
        if parameters.disk_full == "delete_oldest" and not (
            parameters.split_bytes or parameters.split_s
        ):
            raise ConfigurationError(
                "logger.disk_full delete_oldest needs logger.split_bytes or "
                "logger.split_s: it deletes finished files"
            )
        self.parameters = parameters
        self.accounts: dict[str, TopicAccount] = {}
        self.deleted: list[str] = []
        self.problem = ""
        self._base = Path(parameters.path)
        self._written = WrittenFiles(self._base)
        self._definition, self._free = definition, free
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: dict[str, tuple[str, bytes]] = {}
        self._latched: dict[
            str, tuple[str, bytes, int, str]
        ] = {}  # packed: a map of a large site is megabytes
        self._packer = zstandard.ZstdCompressor(level=1)
        self._log: McapLog | None = None
        self._again = 0.0
        self._began, self._seen = 0.0, 0
        self._settled: dict[str, int] = {}
        self.path = self._base
        refused = self._refusal_reason()
        if refused:
            raise OutputError(f"{self._base}: cannot be written: {refused}", value=str(self._base))
        if self.has_room(1):
            self._open(0)
        else:
            self._wait_for_room()

    # what every file holds
    # ----------------------------------------------------------------------------------------
    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Named text values that every file of the log holds."""
        self._metadata[name] = values
        self._try(lambda log: log.metadata(name, values))

    def attach(self, name: str, media_type: str, data: bytes, t_ns: int) -> None:
        """A file that every file of the log holds as an attachment."""
        self._attachments[name] = (media_type, data)
        self._try(lambda log: log.attach(name, media_type, data, t_ns))

    # messages
    # ----------------------------------------------------------------------------------------------
    def account(self, topic: str) -> TopicAccount:
        """The account of a topic."""
        return self.accounts.setdefault(topic, TopicAccount())

    def write(
        self,
        topic: str,
        kind: str,
        data: bytes,
        t_ns: int,
        published_ns: int | None = None,
        sequence: int = 0,
        qos: str = "",
        latched: bool = False,
    ) -> None:
        """Append one serialised message. The last message of a ``latched`` topic opens every
        further file of the log.
        """
        self.account(topic).bytes += len(data)
        if latched:
            self._latched[topic] = (
                kind,
                self._packer.compress(data),
                published_ns if published_ns is not None else t_ns,
                qos,
            )
        if self._log is None and not self._resume(t_ns):
            self.account(topic).disk += 1
            return
        self._try(
            lambda log: log.write(topic, kind, data, t_ns, published_ns, sequence, qos), topic
        )
        self._after_chunks(t_ns)

    def tick(self, t_ns: int) -> None:
        """Write a chunk that is old enough, look at the disk; several times a second."""
        self._try(McapLog.tick)
        if self._log is None:
            self._resume(t_ns)
        self._after_chunks(t_ns)

    def _after_chunks(self, t_ns: int) -> None:
        """Where chunks were written: settle the accounts, split, make room."""
        log = self._log
        if log is None:
            return
        self._settle(log)
        size = log.size
        if size != self._seen:
            self._seen = size
            self._room()
        p = self.parameters
        old = p.split_s and time.monotonic() - self._began >= p.split_s
        if self._log is not None and (old or (p.split_bytes and size >= p.split_bytes)):
            self.split(t_ns)

    def _settle(self, log: McapLog) -> None:
        for topic, accepted in log.accepted.items():
            fresh = accepted - log.pending.get(topic, 0) - self._settled.get(topic, 0)
            if fresh > 0:
                self.account(topic).written += fresh
                self._settled[topic] = self._settled.get(topic, 0) + fresh

    def _try(self, action: Callable[[McapLog], Any], topic: str | None = None) -> None:
        log = self._log
        if log is None:
            return
        before = log.accepted.get(topic or "", 0)
        try:
            action(log)
        except OutputError as error:
            if topic is not None and log.accepted.get(topic, 0) == before:
                self.account(topic).disk += 1
            self._handle_disk_error(error)

    # files
    # ----------------------------------------------------------------------------------------------
    def _open(self, t_ns: int) -> None:
        files = log_files(self._base)
        number = 0 if not files else 1 + int(files[-1].stem[len(self._base.stem) + 1 :] or 0)
        path = (
            self._base
            if not files
            else self._base.with_name(f"{self._base.stem}_{number}{self._base.suffix}")
        )
        log = McapLog(self.parameters, path, self._definition)
        self._written.add(path)
        self._log, self.path, self._began, self._seen = log, path, time.monotonic(), 0
        self._settled = {}
        for name, values in self._metadata.items():
            log.metadata(name, values)
        for name, (media_type, data) in self._attachments.items():
            log.attach(name, media_type, data, t_ns)
        for topic, (kind, data, published_ns, qos) in self._latched.items():
            log.write(topic, kind, zstandard.decompress(data), t_ns, published_ns, 0, qos)
        self._settled = dict(log.accepted)  # repeats are in no account

    def split(self, t_ns: int) -> None:
        """Finish this file and go on in the next."""
        self._finish()
        self._again = 0.0
        self._resume(t_ns)

    def _finish(self) -> None:
        log = self._log
        if log is None:
            return
        try:
            log.flush()
            self._settle(log)
            log.metadata(
                "messages", {t: json.dumps(asdict(a)) for t, a in list(self.accounts.items())}
            )
            log.close()
            self._log = None
        except OutputError as error:
            self._handle_disk_error(error)

    def close(self) -> None:
        """Finish the file with its index and the account of all topics."""
        self._finish()

    # the disk
    # ----------------------------------------------------------------------------------------------
    def _handle_disk_error(self, error: OutputError) -> None:
        """The disk refused: what was in the chunk is lost and counted; the file is made whole if
        the disk takes an index.
        """
        log, self._log = self._log, None
        assert log is not None
        self.problem = str(error)
        self._again = time.monotonic() + RETRY_S
        log.abandon()
        self._settle(log)
        for topic, accepted in log.accepted.items():
            self.account(topic).disk += accepted - self._settled.get(topic, 0)
        try:
            recover(log.path)
        except OutputError:
            self.problem = f"{self.problem}; unfinished until the next start"

    def _room(self) -> None:
        """Keep the reserve free, else finish this file and wait."""
        if not self.has_room(1):
            self._finish()
            self._wait_for_room()

    def _refusal_reason(self) -> str:
        """Why no file can be made where the log is to be, whatever is free; empty where one can."""
        folder = self._base.parent.absolute()
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            return f"{folder} is no folder"
        if self._base.is_dir():
            return "it is a folder"
        if not os.access(folder, os.W_OK | os.X_OK):
            return f"no right to write to {folder}"
        try:
            return "" if os.statvfs(folder).f_blocks else f"{folder} holds no files"
        except OSError as error:
            return str(error)

    def _wait_for_room(self) -> None:
        refused = self._refusal_reason()
        if refused:
            self.problem = f"{self._base}: cannot be written: {refused}"
            self._again = time.monotonic() + RETRY_S
            return
        self.problem = (
            f"disk full: less than {self.parameters.disk_reserve_bytes} bytes free in "
            f"{self._base.parent.absolute()}"
        )
        self._again = time.monotonic() + RETRY_S

    def has_room(self, times: int) -> bool:
        """Whether so many reserves are free, if need be after the oldest finished files were
        deleted, where the parameters say so.
        """
        enough = times * self.parameters.disk_reserve_bytes
        if self.parameters.disk_full == "delete_oldest":
            for old in log_files(self._base):
                if self.free() >= enough or (old == self.path and self._log is not None):
                    break
                if not self._written.holds(old):
                    continue
                old.unlink(missing_ok=True)
                self.deleted.append(old.name)
        return self.free() >= enough

    def free(self) -> int:
        """Bytes left on the disk; 0 where that cannot be found out."""
        try:
            return self._free(self._base.parent)
        except OSError:
            return 0

    def _resume(self, t_ns: int) -> bool:
        """Open the next file, where there is room for one."""
        if time.monotonic() < self._again:
            return False
        self._again = time.monotonic() + RETRY_S
        if not self.has_room(2 if self.problem else 1):
            return False
        try:
            self._open(t_ns)
        except OutputError as error:
            if self._log is not None:
                self._handle_disk_error(error)
            self.problem = str(error)
            return False
        self.problem = ""
        return True

    def repair_older(self) -> list[Recovery | OutputError]:
        """Make whole what a killed run left behind; every file of this log but the one being
        written.
        """
        done: list[Recovery | OutputError] = []
        for path in log_files(self._base):
            try:
                if path != self.path and not is_complete(path):
                    done.append(recover(path))
            except OutputError as error:
                done.append(error)
            except OSError as error:
                done.append(OutputError(f"{path}: {error}", value=str(path)))
        return done

    def losses(self) -> Losses:
        """Messages that are not in the log, by reason and topic."""
        total = Losses()
        for topic, a in list(self.accounts.items()):
            for reason in ("middleware", "queue", "disk"):
                total.add(f"message_{reason}_{topic}", getattr(a, reason))
        return total

"""One MCAP file: raw CDR bytes in zstd chunks, flushed by time, that Foxglove and ``ros2 bag play``
open.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

from ladar_volume.io.bags import TYPESTORE
from ladar_volume.model.errors import OutputError
from ladar_volume.model.parameters import LoggerParameters
from ladar_volume.process.file_lock import lock
from ladar_volume.version import version

COMPRESSION = {
    "zstd": CompressionType.ZSTD,
    "lz4": CompressionType.LZ4,
    "none": CompressionType.NONE,
}
LIBRARY = "ladar_volume"


def usual_definition(kind: str) -> str:
    """Message definition of a type of the common interfaces; empty where it is none of them."""
    return (
        str(TYPESTORE.generate_msgdef(kind, ros_version=2)[0])
        if kind in TYPESTORE.fielddefs
        else ""
    )


def _confirm(descriptor: int) -> None:
    """The data are on the disk when it returns; the times of the file too where the system does
    not tell them apart.
    """
    if hasattr(os, "fdatasync"):
        os.fdatasync(descriptor)
    else:
        os.fsync(descriptor)


class _Syncer:
    """Asks the disk to confirm, in a thread of its own: a slow confirmation must not hold up the
    next chunk.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._due, self._ended = threading.Event(), False
        self._error: OSError | None = None
        self.thread = threading.Thread(target=self._run, name="sync", daemon=True)
        self.thread.start()

    def _run(self) -> None:
        while True:
            self._due.wait()
            if self._ended:
                return
            self._due.clear()
            try:
                _confirm(self._descriptor)
            except OSError as error:
                self._error = error

    def request(self) -> None:
        """Confirm what has been written. Raises what an earlier request failed with."""
        if self._error is not None:
            raise self._error
        self._due.set()

    def end(self) -> None:
        """Wait for a confirmation in progress; no further one is asked for."""
        self._ended = True
        self._due.set()
        self.thread.join()


class McapLog:
    """A new file. Not thread-safe: one writer thread. Raises OutputError where the file exists or
    the disk refuses.

    ``definition`` gives the ros2msg text of a message type.
    """

    def __init__(
        self,
        parameters: LoggerParameters,
        path: str | Path | None = None,
        definition: Callable[[str], str] = usual_definition,
    ) -> None:
        self.parameters = parameters
        self.path = Path(path if path is not None else parameters.path)
        #: Messages per topic that were taken in, and those of them that are not in a written chunk
        #: yet.
        self.accepted: dict[str, int] = {}
        self.pending: dict[str, int] = {}
        self._definition = definition
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._chunk_began: tuple[float, int] | None = None
        self._disk(self._open)

    def _open(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = self.path.open("xb")
        lock(self._stream.fileno())  # nobody repairs a file that is being written
        self.syncer = _Syncer(self._stream.fileno()) if self.parameters.sync == "chunk" else None
        self._writer = Writer(
            self._stream, chunk_size=2**31, compression=COMPRESSION[self.parameters.compression]
        )
        self._writer.start(profile="ros2", library=f"{LIBRARY} {version()}")
        self._stream.flush()  # from here on a killed logger leaves a file that can be repaired

    def __enter__(self) -> McapLog:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _disk(self, action: Callable[[], Any]) -> None:
        try:
            action()
        except OSError as error:
            raise OutputError(
                f"{self.path}: cannot be written: {error}", value=str(self.path)
            ) from error

    @property
    def size(self) -> int:
        """Bytes in written chunks."""
        return self._stream.tell()

    def write(
        self,
        topic: str,
        kind: str,
        data: bytes,
        t_ns: int,
        published_ns: int | None = None,
        sequence: int = 0,
        qos: str = "",
    ) -> None:
        """Append one serialised message; ``kind`` as ``sensor_msgs/msg/Imu``, ``t_ns`` the receive
        time.

        A chunk is written before it spans more than ``chunk_s`` of receive time or of real time, or
        ``chunk_bytes``.
        """
        if (
            self._chunk_began is not None
            and abs(t_ns - self._chunk_began[1]) >= self.parameters.chunk_s * 1e9
        ):
            self.flush()
        if self._chunk_began is None:
            self._chunk_began, self._chunk_bytes = (time.monotonic(), t_ns), 0
        published = t_ns if published_ns is None else published_ns
        self._writer.add_message(
            self._channel(topic, kind, qos), t_ns, data, published, sequence & 0xFFFFFFFF
        )
        self.accepted[topic] = self.accepted.get(topic, 0) + 1
        self.pending[topic] = self.pending.get(topic, 0) + 1
        self._chunk_bytes += len(data)
        if self._chunk_bytes >= self.parameters.chunk_bytes:
            self.flush()
        self.tick()

    def write_message(self, topic: str, message: Any, t_ns: int) -> None:
        """Append a message object of the package's type store."""
        kind = str(message.__msgtype__)
        self.write(topic, kind, bytes(TYPESTORE.serialize_cdr(message, kind)), t_ns)

    def tick(self) -> None:
        """Write the chunk if it is old enough; to be called when no message comes, too."""
        if (
            self._chunk_began is not None
            and time.monotonic() - self._chunk_began[0] >= self.parameters.chunk_s
        ):
            self.flush()

    def flush(self) -> None:
        """Write the chunk in progress to the disk."""
        self._chunk_began = None
        self._disk(self._flush)
        self.pending = {}

    def _flush(self) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._stream.flush()
        if self.syncer is not None:
            self.syncer.request()

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Attach named text values, such as the effective parameters."""
        self._disk(lambda: self._writer.add_metadata(name, values))
        self._disk(self._stream.flush)

    def attach(self, name: str, media_type: str, data: bytes, t_ns: int) -> None:
        """Attach a file."""
        self._disk(lambda: self._writer.add_attachment(t_ns, t_ns, name, media_type, data))
        self._disk(self._stream.flush)

    def close(self) -> None:
        """Finish the file with its index."""
        if not self._stream.closed:
            self._disk(self._finish)
            self.pending = {}

    def _finish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.flush()
        self._end_sync()
        os.fsync(self._stream.fileno())
        self._stream.close()

    def _end_sync(self) -> None:
        if self.syncer is not None:
            self.syncer.end()
            self.syncer = None

    def abandon(self) -> None:
        """Let go of a file the disk no longer takes; what it holds can be repaired."""
        self._end_sync()
        with contextlib.suppress(
            OSError
        ):  # the buffer could not be written; the descriptor is closed all the same
            self._stream.close()

    def _channel(self, topic: str, kind: str, qos: str) -> int:
        if topic not in self._channels:
            if kind not in self._schemas:
                definition = self._definition(kind)
                self._schemas[kind] = self._writer.register_schema(
                    kind, "ros2msg", definition.encode()
                )
            metadata = {"offered_qos_profiles": qos} if qos else {}
            self._channels[topic] = self._writer.register_channel(
                "/" + topic.lstrip("/"), "cdr", self._schemas[kind], metadata
            )
        return self._channels[topic]

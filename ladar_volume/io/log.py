"""The MCAP log: raw CDR bytes in zstd chunks, flushed by time, that Foxglove and ``ros2 bag play`` open."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer

from ladar_volume.io.bags import TYPESTORE
from ladar_volume.model.errors import OutputError
from ladar_volume.model.parameters import LoggerParameters
from ladar_volume.version import version

COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


class McapLog:
    """One or, with ``split_bytes``, several numbered files. Not thread-safe: one writer thread."""

    def __init__(self, parameters: LoggerParameters, path: str | Path | None = None) -> None:
        self.parameters = parameters
        self._base = Path(path if path is not None else parameters.path)
        self._part = 0
        self.messages = 0
        self._open()

    def _open(self) -> None:
        name = self._base if self._part == 0 else self._base.with_name(f"{self._base.stem}_{self._part}{self._base.suffix}")
        try:
            name.parent.mkdir(parents=True, exist_ok=True)
            self._stream = name.open("wb")
        except OSError as error:
            raise OutputError(f"{name}: cannot be written: {error}", value=str(name)) from error
        self.path = name
        self._writer = Writer(self._stream, chunk_size=self.parameters.chunk_bytes, compression=COMPRESSION[self.parameters.compression])
        self._writer.start(profile="ros2", library=f"ladar_volume {version()}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._flushed_ns: int | None = None

    def __enter__(self) -> McapLog:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def write(self, topic: str, kind: str, data: bytes, t_ns: int) -> None:
        """Append one serialised message; ``kind`` as ``sensor_msgs/msg/Imu``. Chunks reach the disk at least every ``chunk_s``.

        Raises OutputError where the disk refuses.
        """
        try:
            self._writer.add_message(self._channel(topic, kind), t_ns, data, t_ns)
            self.messages += 1
            if self._flushed_ns is None:
                self._flushed_ns = t_ns
            if t_ns - self._flushed_ns >= self.parameters.chunk_s * 1e9 or t_ns < self._flushed_ns:
                self._writer.flush()  # type: ignore[no-untyped-call]
                self._stream.flush()
                self._flushed_ns = t_ns
            if self.parameters.split_bytes and self._stream.tell() >= self.parameters.split_bytes:
                self.split()
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error}", value=str(self.path)) from error

    def write_message(self, topic: str, message: Any, t_ns: int) -> None:
        """Append a message object of the package's type store."""
        kind = str(message.__msgtype__)
        self.write(topic, kind, bytes(TYPESTORE.serialize_cdr(message, kind)), t_ns)

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Attach named text values, such as the effective parameters."""
        self._writer.add_metadata(name, values)

    def split(self) -> Path:
        """Finish this file and go on in the next; returns the finished one."""
        done = self.path
        self.close()
        self._part += 1
        self._open()
        return done

    def close(self) -> None:
        """Finish the file with its index."""
        if not self._stream.closed:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._stream.close()

    def _channel(self, topic: str, kind: str) -> int:
        if topic not in self._channels:
            if kind not in self._schemas:
                definition = TYPESTORE.generate_msgdef(kind, ros_version=2)[0] if kind in TYPESTORE.fielddefs else ""
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition.encode())
            self._channels[topic] = self._writer.register_channel("/" + topic.lstrip("/"), "cdr", self._schemas[kind])
        return self._channels[topic]

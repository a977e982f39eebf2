"""Recordings: rosbag2 (MCAP, sqlite3, split), ROS 1 bags and bare MCAP files in; rosbag2 MCAP
out.
"""

from __future__ import annotations

import contextlib
import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import ladar_volume.io.bounded_unpacking  # noqa: F401  (bounds what rosbags unpacks)
from ladar_volume.io.drivers import velodyne_scan
from ladar_volume.io.frames import moving_frames, static_frames
from ladar_volume.io.logs import unheard
from ladar_volume.model.errors import BagError, OutputError, short_repr
from ladar_volume.model.parameters import Parameters

#: What the pipeline listens to: role → (message type, usual topic).
ROLES: dict[str, tuple[str, str]] = {
    "cloud": ("sensor_msgs/msg/PointCloud2", "velodyne_points"),
    "fix": ("sensor_msgs/msg/NavSatFix", "gnss/fix"),
    "imu": ("sensor_msgs/msg/Imu", "imu/data"),
    "odometry": ("nav_msgs/msg/Odometry", "odometry"),
}
#: What stands in for a role where nothing of its own type was recorded.
INSTEAD = {"cloud": (velodyne_scan.KIND, velodyne_scan.TOPIC)}
#: What may be asked for in a role by name: poses as transforms.
BY_NAME = {"odometry": (static_frames.KIND, moving_frames.TOPIC)}
TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
for _name, _text in velodyne_scan.DEFINITIONS.items():
    TYPESTORE.register(get_types_from_msg(_text, _name))


def wanted_topics(given: Mapping[str, str], parameters: Parameters) -> dict[str, str]:
    """Role → topic as given, and ``/tf`` where the parameters take the poses from there."""
    transforms = parameters.node.odometry_message == "TFMessage"
    if parameters.georeference.pose_source != "odometry" or not transforms:
        return dict(given)
    return {"odometry": moving_frames.TOPIC, **given}


@dataclass(frozen=True)
class Raw:
    """One recorded message: receive time (ns), topic without leading slash, type, serialised
    bytes.
    """

    t_ns: int
    topic: str
    kind: str
    data: bytes


class Recording(ABC):
    """Messages of topics in the order in which they came; use as a context manager."""

    path: Path
    #: Recordings that it consists of; of a single one none.
    parts: tuple[Recording, ...] = ()

    @property
    @abstractmethod
    def start_ns(self) -> int:
        """Receive time of the first message."""

    @property
    @abstractmethod
    def duration_s(self) -> float:
        """From first to last message."""

    @abstractmethod
    def topics(self) -> dict[str, tuple[str, int]]:
        """Topic (without leading slash) → type and number of messages."""

    @abstractmethod
    def raw(
        self, topics: set[str] | None = None, span: tuple[int, int] | None = None
    ) -> Iterator[Raw]:
        """Messages in receive order, those from ``span[0]`` to ``span[1]`` (ns) where it is given.
        Raises BagError (bag_truncated) where the file breaks off or holds fewer than it announces.
        """

    @abstractmethod
    def message(self, raw: Raw) -> Any:
        """Deserialise. Raises BagError (bag_message) for bytes that are not such a message."""

    @abstractmethod
    def digest(self) -> str:
        """sha256 over the recording's data files in name order."""

    @abstractmethod
    def __enter__(self) -> Recording:
        """Opened already."""

    @abstractmethod
    def __exit__(self, *error: object) -> None:
        """Close the files."""

    def left_out(self) -> dict[str, int]:
        """Messages by topic that a log has, and the nodes had not heard live: in no count here."""
        total: dict[str, int] = {}
        for part in self.parts:
            for topic, count in part.left_out().items():
                total[topic] = total.get(topic, 0) + count
        return total

    def roles(self, wanted: Mapping[str, str] | None = None) -> dict[str, str]:
        """Role → topic: as ``wanted``, else the usual name, else the only topic of the type, else
        the same of the type that stands in (:data:`INSTEAD`).

        Raises BagError (bag_topic) where a wanted topic is absent or has another type.
        """
        topics, found = self.topics(), {}
        for role, own in ROLES.items():
            name = (wanted or {}).get(role, "").lstrip("/")
            kinds = [own, *([INSTEAD[role]] if role in INSTEAD else [])]
            kinds += [BY_NAME[role]] if name and role in BY_NAME else []
            if name and topics.get(name, ("", 0))[0] not in [kind for kind, _ in kinds]:
                raise BagError(
                    f"{self.path}: no topic {name!r} of type {own[0]}",
                    reason="bag_topic",
                    value=name,
                )
            for kind, usual in kinds:
                candidates = [t for t, (k, _) in topics.items() if k == kind]
                only = candidates[0] if len(candidates) == 1 else ""
                chosen = name or (usual if usual in candidates else only)
                if chosen:
                    found[role] = chosen
                    break
        return found

    def require(self, roles: Mapping[str, str], pose_source: str) -> None:
        """Check that the topics a volume needs are there; raises BagError (bag_topic) naming what
        is missing.
        """
        needed = ("cloud", "fix", "imu") if pose_source == "gnss_imu" else ("cloud", "odometry")
        missing = [f"{role} ({ROLES[role][0]})" for role in needed if role not in roles]
        if missing:
            hint = "; --poses LOG takes poses from an autopilot's log" if "cloud" in roles else ""
            raise BagError(
                (
                    f"{self.path}: no topic for {', '.join(missing)}; the recording has "
                    f"{', '.join(self.topics())}{hint}"
                ),
                reason="bag_topic",
                value=missing,
            )


class BagReader(Recording):
    """A recording of ROS, opened on construction. Of a log of the nodes that is what they heard,
    without what the log names as heard by itself alone, unless ``all_messages`` asks for that.

    Raises :class:`BagError` with reason bag_missing, bag_format, bag_empty or bag_truncated.
    """

    def __init__(self, path: str | Path, all_messages: bool = False) -> None:
        self.path = Path(path)
        self._unheard = unheard.NONE
        if not self.path.exists():
            raise BagError(f"{self.path}: no such recording", reason="bag_missing", value=str(path))
        try:
            self._reader = AnyReader([self._target()], default_typestore=TYPESTORE)
            self._reader.open()
            self._check_numbers()
        except (AnyReaderError, Ros1Error, Ros2Error) as error:
            raise BagError(
                f"{self.path}: not a readable recording: {short_repr(str(error))}",
                reason="bag_format",
                value=str(path),
            ) from error
        except BagError as error:
            raise BagError(f"{self.path}: {error}", reason=error.reason) from error
        except Exception as error:  # a damaged file fails anywhere inside the parsers
            raise BagError(
                f"{self.path}: damaged or not a recording: {short_repr(error)}",
                reason="bag_format",
                value=str(path),
            ) from error
        if self._reader.message_count == 0:
            self.close()
            raise BagError(
                f"{self.path}: the recording holds no message", reason="bag_empty", value=str(path)
            )
        if not all_messages:
            self._unheard = self._named_as_unheard()

    def _named_as_unheard(self) -> unheard.UnheardMessages:
        """What the recording says of itself; nothing where it breaks off, which its reader says."""
        topics = {t for t, (k, _) in self.topics().items() if k == unheard.KIND}
        topics = {t for t in topics if f"/{t}".endswith(f"/{unheard.TOPIC}")}
        found: list[unheard.Unheard] = []
        with contextlib.suppress(BagError):
            for raw in self.raw(topics) if topics else ():
                named = unheard.unheard_from_text(self.message(raw).data)
                found += [] if named is None else [named]
        return unheard.UnheardMessages(found)

    def left_out(self) -> dict[str, int]:
        """Messages by topic that the log alone had heard."""
        return dict(self._unheard.counts())

    def _check_numbers(self) -> None:
        """Counts and times of metadata.yaml are whole numbers: the library takes what is there."""
        counts = [c.msgcount for c in self._reader.connections]
        times = [self._reader.start_time, self._reader.duration, self._reader.message_count]
        for number in (*counts, *times):
            if not isinstance(number, int):
                raise TypeError(f"metadata.yaml has {number!r} for a count or a time")

    def _target(self) -> Path:
        if self.path.is_dir() and not (self.path / "metadata.yaml").exists():
            files = sorted(p for p in self.path.iterdir() if p.suffix in (".mcap", ".db3", ".bag"))
            if len(files) != 1:
                raise BagError(
                    f"{self.path}: a folder without metadata.yaml",
                    reason="bag_format",
                    value=str(self.path),
                )
            return files[0]
        return self.path

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    @property
    def start_ns(self) -> int:
        """Receive time of the first message."""
        return int(self._reader.start_time)

    @property
    def duration_s(self) -> float:
        """From first to last message."""
        return float(self._reader.duration) * 1e-9

    def topics(self) -> dict[str, tuple[str, int]]:
        """Topic (without leading slash) → type and number of messages."""
        found: dict[str, tuple[str, int]] = {}
        for c in self._reader.connections:
            name = c.topic.lstrip("/")
            found[name] = (c.msgtype, found.get(name, ("", 0))[1] + c.msgcount)
        for name, count in self._unheard.counts().items():
            if name in found:
                found[name] = (found[name][0], max(found[name][1] - count, 0))
        return dict(sorted(found.items()))

    def raw(
        self, topics: set[str] | None = None, span: tuple[int, int] | None = None
    ) -> Iterator[Raw]:
        """Messages in receive order, those from ``span[0]`` to ``span[1]`` (ns) where it is given.
        Raises BagError (bag_truncated) where the file breaks off or holds fewer than it announces.
        """
        connections = [
            c for c in self._reader.connections if topics is None or c.topic.lstrip("/") in topics
        ]
        if not connections:
            return
        missing = sum(c.msgcount for c in connections) if span is None else 0
        first, last = (None, None) if span is None else (span[0], span[1] + 1)
        try:
            for connection, t_ns, data in self._reader.messages(connections, first, last):
                missing -= 1
                topic = connection.topic.lstrip("/")
                if not (self._unheard and self._unheard.hold(topic, t_ns, data)):
                    yield Raw(t_ns, topic, connection.msgtype, data)
        except BagError as error:
            raise BagError(f"{self.path}: {error}", reason=error.reason) from error
        except (
            Exception
        ) as error:  # as above: any parser error means the file is damaged from here on
            raise BagError(
                f"{self.path}: the recording breaks off: {short_repr(error)}",
                reason="bag_truncated",
                value=str(self.path),
            ) from error
        if missing > 0:
            raise BagError(
                f"{self.path}: {missing} announced messages cannot be read",
                reason="bag_truncated",
                value=missing,
            )

    def message(self, raw: Raw) -> Any:
        """Deserialise. Raises BagError (bag_message) for bytes that are not such a message."""
        try:
            return self._reader.deserialize(raw.data, raw.kind)
        except Exception as error:  # a damaged message can fail anywhere in the deserialiser
            raise BagError(
                f"{raw.topic}: undecodable {raw.kind}: {short_repr(error)}",
                reason="bag_message",
                value=raw.topic,
            ) from error

    def digest(self) -> str:
        """sha256 over the recording's data files in name order."""
        target = self._target()
        files = (
            [target]
            if target.is_file()
            else sorted(p for p in target.iterdir() if p.suffix in (".mcap", ".db3", ".bag"))
        )
        sha = hashlib.sha256()
        for file in files:
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    sha.update(block)
        return sha.hexdigest()


class BagWriter:
    """A new rosbag2 MCAP recording. Raises OutputError where it cannot be written."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.exists():
            raise OutputError(
                f"{self.path} exists already", reason="output_exists", value=str(path)
            )
        try:
            self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except OSError as error:
            raise OutputError(
                f"{self.path}: cannot be written: {error}", value=str(path)
            ) from error
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *error: object) -> None:
        self._writer.close()

    def write(self, topic: str, message: Any, t_ns: int) -> None:
        """Serialise and append one message; the type is the message's own."""
        kind = str(message.__msgtype__)
        self.write_raw(topic, kind, bytes(TYPESTORE.serialize_cdr(message, kind)), t_ns)

    def write_raw(self, topic: str, kind: str, data: bytes, t_ns: int) -> None:
        """Append serialised bytes."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                "/" + topic.lstrip("/"), kind, typestore=TYPESTORE
            )
        self._writer.write(self._connections[topic], t_ns, data)

"""Repair of an MCAP file whose writer was killed: the records that are whole stay where they are,
what is torn is cut off the end, and the index and footer the writer never came to write are added.
Nothing in front of the tear is moved or rewritten.

Format: MCAP specification, mcap.dev/spec. Every record is opcode (1 byte), length (8 bytes),
content.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from ladar_volume.io.bounded_unpacking import check_chunk
from ladar_volume.model.errors import OutputError
from ladar_volume.process.file_lock import lock

HEAD = struct.Struct("<BQ")
#: A tear at the end is at most the chunk that was being written. A longer rest means damage in the
#: middle, which is not cut off.
LONGEST_TAIL = 64_000_000


@dataclass(frozen=True)
class Recovery:
    """What a repair found: messages kept, bytes cut off the end, chunks (and other records) whose
    content is damaged.
    """

    path: Path
    messages: int
    lost_bytes: int
    damaged: int


@dataclass
class _Contents:
    """The index of a file, gathered from its records."""

    end: int = 0
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    attachments: list[records.AttachmentIndex] = field(default_factory=list)
    metadata: list[records.MetadataIndex] = field(default_factory=list)
    #: Message indexes of the last chunk, from its content, and the channels whose index is not in
    #: the file.
    last: dict[int, records.MessageIndex] = field(default_factory=dict)
    missing: set[int] = field(default_factory=set)
    damaged: int = 0

    @property
    def span(self) -> tuple[int, int]:
        """First and last receive time, zeros where there is no message."""
        if not self.chunks:
            return 0, 0
        return min(c.message_start_time for c in self.chunks), max(
            c.message_end_time for c in self.chunks
        )


def is_complete(path: Path) -> bool:
    """Whether a file ends as its writer meant it to."""
    with path.open("rb") as stream:
        if stream.seek(0, os.SEEK_END) < 2 * len(MCAP0_MAGIC):
            return False
        stream.seek(-len(MCAP0_MAGIC), os.SEEK_END)
        return stream.read() == MCAP0_MAGIC


def recover(path: Path) -> Recovery:
    """Make a torn file whole, in place. A whole file is left as it is.

    Raises OutputError: ``log_damaged`` for a file that is no MCAP or is damaged far before its end,
    ``log_in_use`` for one that is being written, both of which are left alone; ``output`` where the
    disk refuses.
    """
    try:
        with path.open("r+b") as stream:
            lock(stream.fileno())
            return _recover(path, stream)
    except BlockingIOError as error:
        raise OutputError(
            f"{path}: is being written", reason="log_in_use", value=str(path)
        ) from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be repaired: {error}", value=str(path)) from error


def _recover(path: Path, stream: BinaryIO) -> Recovery:
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    start = stream.read(len(MCAP0_MAGIC))
    if not MCAP0_MAGIC.startswith(start):
        raise OutputError(f"{path}: not an MCAP file", reason="log_damaged", value=str(path))
    contents = _scan(stream, size)
    lost = size - contents.end
    whole = is_complete(path)
    if not whole:
        if lost > LONGEST_TAIL and not _ends_here(stream, contents.end):
            raise OutputError(
                (
                    f"{path}: damaged at byte {contents.end} of {size}, too far from its end "
                    "to cut the rest off"
                ),
                reason="log_damaged",
                value=contents.end,
            )
        stream.seek(contents.end)
        stream.truncate()
        stream.write(_closing_records(contents))
        stream.flush()
        os.fsync(stream.fileno())
    return Recovery(
        path,
        sum(contents.counts.values()),
        0 if whole else lost,
        contents.damaged,
    )


def _ends_here(stream: BinaryIO, offset: int) -> bool:
    """Whether nothing but zeros follows (blocks a power cut left unwritten) or the end of the data
    is here.
    """
    stream.seek(offset)
    if stream.read(1) == bytes([Opcode.DATA_END]):
        return True
    stream.seek(offset)
    while block := stream.read(1 << 20):
        if block.strip(b"\x00"):
            return False
    return True


def _records(stream: BinaryIO, offset: int, size: int) -> Iterator[tuple[int, int, int]]:
    """(offset, opcode, content length) of the whole records, up to the tear or to the end of the
    data.
    """
    while offset + HEAD.size <= size:
        stream.seek(offset)
        opcode, length = HEAD.unpack(stream.read(HEAD.size))
        known = Opcode.HEADER <= opcode <= Opcode.METADATA_INDEX and opcode != Opcode.FOOTER
        if not known or offset + HEAD.size + length > size:
            return
        yield offset, opcode, length
        offset += HEAD.size + length


def _scan(stream: BinaryIO, size: int) -> _Contents:
    contents = _Contents()
    for offset, opcode, length in _records(stream, len(MCAP0_MAGIC), size):
        after = offset + HEAD.size + length
        if opcode == Opcode.CHUNK:
            _add_chunk(contents, stream.read(length), offset)
        elif opcode == Opcode.MESSAGE_INDEX:
            _add_message_index(contents, stream.read(2), offset, after)
            if contents.missing:
                # should those that follow be torn, all of this chunk are written anew behind it
                continue
        elif opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            _add_extra(contents, opcode, stream.read(length), offset)
        elif opcode != Opcode.HEADER:
            break  # the end of the data, or a summary
        contents.end = after
    return contents


def _add_chunk(contents: _Contents, content: bytes, offset: int) -> None:
    contents.last, contents.missing = {}, set()
    try:
        chunk = records.Chunk.read(ReadDataStream(BytesIO(content)))
        check_chunk(chunk.data, chunk.compression, chunk.uncompressed_size)
        data, _ = get_chunk_data_stream(chunk, validate_crc=True)
        _read_chunk(contents, data.read(chunk.uncompressed_size))
    except (
        Exception
    ):  # a damaged chunk fails anywhere in decompression or parsing; its neighbours are good
        contents.damaged += 1
        return
    contents.chunks.append(
        records.ChunkIndex(
            chunk_length=HEAD.size + len(content),
            chunk_start_offset=offset,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            message_index_length=0,
            message_index_offsets={},
            uncompressed_size=chunk.uncompressed_size,
        )
    )


def _read_chunk(contents: _Contents, data: bytes) -> None:
    index: dict[int, records.MessageIndex] = {}
    position = 0
    while position < len(data):
        opcode, length = HEAD.unpack_from(data, position)
        body = position + HEAD.size
        if opcode == Opcode.MESSAGE:
            (channel,) = struct.unpack_from("<H", data, body)
            (t_ns,) = struct.unpack_from("<Q", data, body + 6)
            index.setdefault(channel, records.MessageIndex(channel, [])).records.append(
                (t_ns, position)
            )
        elif opcode == Opcode.SCHEMA:
            schema = records.Schema.read(ReadDataStream(BytesIO(data[body : body + length])))
            contents.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            found = records.Channel.read(ReadDataStream(BytesIO(data[body : body + length])))
            contents.channels[found.id] = found
        position = body + length
    for channel, entries in index.items():
        contents.counts[channel] = contents.counts.get(channel, 0) + len(entries.records)
    contents.last, contents.missing = index, set(index)


def _add_message_index(contents: _Contents, head: bytes, offset: int, after: int) -> None:
    (channel,) = struct.unpack("<H", head)
    if channel not in contents.missing:
        return  # of a damaged chunk, which is not in the index
    contents.missing.remove(channel)
    chunk = contents.chunks[-1]
    chunk.message_index_offsets[channel] = offset
    chunk.message_index_length += after - offset


def _add_extra(contents: _Contents, opcode: int, content: bytes, offset: int) -> None:
    stream, length = ReadDataStream(BytesIO(content)), HEAD.size + len(content)
    try:
        a = (records.Metadata if opcode == Opcode.METADATA else records.Attachment).read(stream)
    except Exception:  # as above
        contents.damaged += 1
        return
    if isinstance(a, records.Metadata):
        contents.metadata.append(records.MetadataIndex(offset=offset, length=length, name=a.name))
        return
    contents.attachments.append(
        records.AttachmentIndex(
            offset=offset,
            length=length,
            log_time=a.log_time,
            create_time=a.create_time,
            data_size=len(a.data),
            name=a.name,
            media_type=a.media_type,
        )
    )


def _summary(contents: _Contents, start: int) -> tuple[RecordBuilder, list[records.SummaryOffset]]:
    """The summary that begins at a byte of the file, and where its groups lie."""
    groups: list[tuple[Opcode, list[records.McapRecord]]] = [
        (Opcode.SCHEMA, [*contents.schemas.values()]),
        (Opcode.CHANNEL, [*contents.channels.values()]),
        (Opcode.STATISTICS, [_statistics(contents)]),
        (Opcode.CHUNK_INDEX, [*contents.chunks]),
        (Opcode.ATTACHMENT_INDEX, [*contents.attachments]),
        (Opcode.METADATA_INDEX, [*contents.metadata]),
    ]
    summary = RecordBuilder()
    offsets = []
    for opcode, group in groups:
        before = summary.count
        for record in group:
            record.write(summary)
        if group:
            offsets.append(records.SummaryOffset(opcode, start + before, summary.count - before))
    return summary, offsets


def _closing_records(contents: _Contents) -> bytes:
    """What belongs behind the last whole record: message indexes of the last chunk, DataEnd,
    summary, footer, magic.
    """
    out = RecordBuilder()
    start = contents.end
    if start == 0:
        out.write(MCAP0_MAGIC)
        records.Header("ros2", "ladar_volume").write(out)
    if contents.missing:
        _reindex_last_chunk(contents, out)
    records.DataEnd(0).write(out)
    summary_start = start + out.count
    summary, offsets = _summary(contents, summary_start)
    offset_start = summary_start + summary.count
    for offset in offsets:
        offset.write(summary)
    text = bytes(summary.end())  # type: ignore[no-untyped-call]
    crc = zlib.crc32(
        struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start), zlib.crc32(text)
    )
    out.write(text)
    records.Footer(
        summary_start=summary_start, summary_offset_start=offset_start, summary_crc=crc
    ).write(out)
    out.write(MCAP0_MAGIC)
    return bytes(out.end())  # type: ignore[no-untyped-call]


def _reindex_last_chunk(contents: _Contents, out: RecordBuilder) -> None:
    chunk, before = contents.chunks[-1], out.count
    chunk.message_index_offsets = {}
    for channel, index in contents.last.items():
        chunk.message_index_offsets[channel] = contents.end + out.count
        index.write(out)
    chunk.message_index_length = out.count - before


def _statistics(contents: _Contents) -> records.Statistics:
    first, last = contents.span
    return records.Statistics(
        attachment_count=len(contents.attachments),
        channel_count=len(contents.channels),
        channel_message_counts=contents.counts,
        chunk_count=len(contents.chunks),
        message_count=sum(contents.counts.values()),
        message_start_time=first,
        message_end_time=last,
        metadata_count=len(contents.metadata),
        schema_count=len(contents.schemas),
    )

"""Cloud-optimised LAZ (COPC 1.0): the points of a LAS 1.4 file as the chunks of an octree.

A node at depth d is a cube of the root's side divided by 2^d. It holds one point of each of its
128³ cells, and leaves the others to its children, so that the nodes down to any depth are the whole
cloud thinned. Every viewer that reads COPC fetches what it shows and no more; every LAZ reader
reads the file as a whole. Specification: copc.io, version 1.0.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import laspy
import lazrs
import numpy as np

from ladar_volume.model.records import F64, I64

#: Bits of the cells across a node: 128.
CELL_BITS = 7
#: Bits of the finest cells across the root; three of them fill 63 bits.
ALL_BITS = 21
#: A node with fewer points below it keeps them all.
LEAF_POINTS = 20_000
#: Points that are packed at a time.
BATCH_POINTS = 2_000_000
#: Bytes of the head of a record behind the points.
LATE_HEAD_BYTES = 60
INFO, ENTRY = struct.Struct("<5d2Q2d88x"), struct.Struct("<4iQ2i")


@dataclass(frozen=True)
class Octree:
    """order : rows of the points, node by node · keys : depth, x, y, z of each node, (n, 4) ·
    first : where each node begins in ``order``, (n + 1,)
    """

    order: I64
    keys: I64
    first: I64


def octree_of(u: F64) -> Octree:
    """The octree of points ``u``, (n, 3), as parts of the root's side, 0 to below 1.

    The same points give the same tree. A cell is held by the middle one of its points along the
    curve of Morton (1966).
    """
    code = _morton(np.minimum((u * 2.0**ALL_BITS).astype(np.int64), 2**ALL_BITS - 1))
    rows = np.argsort(code, kind="stable")
    code = code[rows]
    orders, keys, counts = [], [], []
    for depth in range(ALL_BITS - CELL_BITS + 1):
        if not len(rows):
            break
        node = code >> 3 * (ALL_BITS - depth)
        starts = _starts(node)
        sizes = np.diff(np.append(starts, len(node)))
        taken = np.repeat((sizes <= LEAF_POINTS) | (depth == ALL_BITS - CELL_BITS), sizes)
        cells = _starts(code >> 3 * (ALL_BITS - CELL_BITS - depth))
        taken[(cells + np.append(cells[1:], len(code))) // 2] = True
        orders.append(rows[taken])
        keys.append(_key(depth, node[starts]))
        counts.append(np.add.reduceat(taken.astype(np.int64), starts))
        rows, code = rows[~taken], code[~taken]
    first = np.concatenate([[0], np.cumsum(np.concatenate([*counts, np.zeros(0, np.int64)]))])
    return Octree(
        np.concatenate([*orders, np.zeros(0, np.int64)]),
        np.concatenate([*keys, np.zeros((0, 4), np.int64)]),
        first.astype(np.int64),
    )


def _starts(sorted_codes: I64) -> I64:
    """Where each run of equal codes begins."""
    return np.flatnonzero(np.diff(sorted_codes, prepend=sorted_codes[:1] - 1))


def _morton(cell: I64) -> I64:
    """Bits of the cells (n, 3) interleaved, x the lowest of each three."""
    code = np.zeros(len(cell), np.int64)
    for axis in range(3):
        code |= _spread(cell[:, axis]) << axis
    return code


def _spread(a: I64) -> I64:
    """21 bits, two places free between each and the next."""
    a = a & 0x1FFFFF
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        a = (a | a << shift) & mask
    return a


def _key(depth: int, node: I64) -> I64:
    """Depth, x, y, z of nodes by their codes."""
    place = np.zeros((len(node), 4), np.int64)
    place[:, 0] = depth
    for bit in range(depth):
        for axis in range(3):
            place[:, 1 + axis] |= (node >> (3 * bit + axis) & 1) << bit
    return place


def write_copc(path: Path, header: laspy.LasHeader, points: laspy.PackedPointRecord) -> None:
    """Write points of format 6, 7 or 8 as COPC. The order of the points is that of the octree.

    header : its records come behind the first, which COPC needs; LAS 1.4, its system as WKT.
    """
    tree, facts = _root(header, points)
    kind = header.point_format
    pack = lazrs.LazVlr.new_for_compression(kind.id, kind.num_extra_bytes, True)
    info = laspy.VLR("copc", 1, "COPC info", INFO.pack(*facts))
    header.vlrs.insert(0, info)
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "", pack.record_data()))
    header.partial_reset()
    if len(points):
        header.grow(points)
    else:
        header.mins = header.maxs = np.zeros(3)
    header.are_points_compressed = True
    with path.open("w+b") as file:
        header.write_to(file)
        packer = lazrs.ParLasZipCompressor(file, pack)
        packer.reserve_offset_to_chunk_table()
        for batch in _batches(points, tree):
            packer.compress_chunks(batch)
        packer.done()
        at = file.seek(0, 2)
        entries = _entries(file, header.offset_to_point_data, pack, tree)
        facts[5:7] = at + LATE_HEAD_BYTES, len(entries)
        info.record_data = INFO.pack(*facts)
        file.seek(at)
        late = laspy.vlrs.vlrlist.VLRList()
        late.append(laspy.VLR("copc", 1000, "EPT hierarchy", entries))
        late.write_to(file, as_extended=True)
        header.number_of_evlrs, header.start_of_first_evlr = 1, at
        file.seek(0)
        header.write_to(file, ensure_same_size=True)


def _root(header: laspy.LasHeader, points: laspy.PackedPointRecord) -> tuple[Octree, list[Any]]:
    """The octree of the points, and what the file says of its root: middle, half the side, spacing,
    place and bytes of the hierarchy (not known yet), first and last time.
    """
    r = np.column_stack([np.asarray(points[axis], np.int64) for axis in "XYZ"]) * header.scales
    r += header.offsets
    low, high = (r.min(axis=0), r.max(axis=0)) if len(r) else (np.zeros(3), np.zeros(3))
    half = max(0.5 * float((high - low).max()) * (1.0 + 1e-9), float(np.max(header.scales)))
    middle = low + half  # some readers take the header's least corner for the cube's
    time = np.asarray(points["gps_time"]) if len(r) else np.zeros(1)
    facts = [*middle, half, 2.0 * half / 2**CELL_BITS, 0, 0, float(time.min()), float(time.max())]
    return octree_of((r - low) / (2.0 * half)), facts


def _batches(points: laspy.PackedPointRecord, tree: Octree) -> Iterator[list[Any]]:
    """Chunks of whole nodes, in the order of the tree, some millions of points at a time."""
    begin = 0
    while begin < len(tree.keys):
        most = tree.first[begin] + BATCH_POINTS
        end = max(begin + 1, int(np.searchsorted(tree.first, most, side="right")) - 1)
        rows = points.array[tree.order[tree.first[begin] : tree.first[end]]]
        flat = np.ascontiguousarray(rows).view(np.uint8).reshape(len(rows), -1)
        cuts = tree.first[begin + 1 : end] - tree.first[begin]
        yield [chunk.reshape(-1) for chunk in np.split(flat, cuts)]
        begin = end


def _entries(file: BinaryIO, first: int, pack: lazrs.LazVlr, tree: Octree) -> bytes:
    """The page of the hierarchy: key, place, bytes and points of each node."""
    file.seek(first)
    held = lazrs.read_chunk_table(file, pack)
    out, at = [], first + 8
    for key, (points, size) in zip(tree.keys.tolist(), held, strict=True):
        out.append(ENTRY.pack(*key, at, size, points))
        at += size
    return b"".join(out) or ENTRY.pack(0, 0, 0, 0, 0, 0, 0)

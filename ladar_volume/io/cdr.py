"""Large map messages as CDR bytes straight from arrays: a Marker or a Mesh of a hundred thousand
corners as message objects takes longer to pack than the volume takes to compute.

XCDR version 1, little-endian, as rmw serialises: a member aligns to its own size, counted from
behind the four-byte encapsulation header (OMG DDSI-RTPS 2.2, section 10.2).
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from ladar_volume.math.se3 import quaternion_from_matrix
from ladar_volume.model.records import F64, I64, Bool, Estimate, Tin

TRIANGLE_LIST = 11
#: Triangles of a marker, about, at most: each takes 120 bytes, in this process, in that of every
#: listener and in between.
MOST_SHOWN = 100_000


class Writer:
    """Appends members in the order of the message definition."""

    def __init__(self) -> None:
        self._parts: list[
            bytes | memoryview
        ] = []  # put together once, at the end: a map is megabytes
        self._length = 0
        self._add(b"\x00\x01\x00\x00")

    def _add(self, part: bytes | memoryview) -> None:
        self._parts.append(part)
        self._length += part.nbytes if isinstance(part, memoryview) else len(part)

    def _align(self, size: int) -> None:
        self._add(bytes(-(self._length - 4) % size))

    def numbers(self, code: str, *values: float) -> None:
        """Numbers of one struct code (``B``, ``i``, ``I``, ``f``, ``d``)."""
        self._align(struct.calcsize(code))
        self._add(struct.pack(f"<{len(values)}{code}", *values))

    def text(self, value: str) -> None:
        """A string."""
        data = value.encode() + b"\x00"
        self.numbers("I", len(data))
        self._add(data)

    def sequence(self, rows: npt.NDArray[Any]) -> None:
        """A sequence of structures that hold ``rows.shape[1]`` numbers of one type each."""
        self.numbers("I", len(rows))
        if len(rows):
            self._align(rows.dtype.itemsize)
            self._add(np.ascontiguousarray(rows, rows.dtype.newbyteorder("<")).data)

    def header(self, t_ns: int, frame: str) -> None:
        """A std_msgs/Header."""
        self.numbers("i", t_ns // 1_000_000_000)
        self.numbers("I", t_ns % 1_000_000_000)
        self.text(frame)

    def bytes(self) -> bytes:
        """The whole message."""
        return b"".join(self._parts)


def shown_triangles(tin: Tin) -> I64:
    """Triangles (k, 3) to be looked at: the relevant ones; of more than :data:`MOST_SHOWN`, those
    left when all vertices in one square of a grid count as one of them.
    """
    triangles = tin.triangles[tin.relevant]
    if len(triangles) <= MOST_SHOWN:
        return triangles.astype(np.int64)
    low, high = tin.vertices[:, :2].min(axis=0), tin.vertices[:, :2].max(axis=0)
    side = math.sqrt(float(np.prod(high - low)) / (0.5 * MOST_SHOWN))
    square, y = (
        np.floor((c - least) / side).astype(np.int64)
        for c, least in zip(tin.vertices.T[:2], low, strict=True)
    )
    square *= int((high - low).max() / side) + 1
    square += y
    _, first, label = np.unique(square, return_index=True, return_inverse=True)
    triangles = first.astype(np.int32)[label][triangles]
    whole: Bool = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return triangles[whole].astype(np.int64)


def tin_marker(estimate: Estimate, value: F64, frame: str) -> bytes:
    """visualization_msgs/Marker: the triangles :func:`shown_triangles` as a TRIANGLE_LIST,
    coloured by a value (n,) of each vertex, in the frame of the map.
    """
    tin = estimate.tin
    corners, inverse = np.unique(shown_triangles(tin), return_inverse=True)
    low, high = float(np.min(value)), float(np.max(value))
    s = (value[corners] - low) / max(high - low, 1e-12)
    colour = np.column_stack(
        [s, 0.6 * (1.0 - np.abs(2.0 * s - 1.0)) + 0.3, 1.0 - s, np.ones(len(s))]
    ).astype(np.float32)
    w = Writer()
    w.header(estimate.volume.t_ns, frame)
    w.text("tin")  # ns
    w.numbers("i", 0, TRIANGLE_LIST, 0)  # id, type, action ADD
    w.numbers("d", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # pose
    w.numbers("d", 1.0, 1.0, 1.0)  # scale
    w.numbers("f", 0.0, 0.0, 0.0, 0.0)  # colour: that of the corners
    w.numbers("i", 0)  # lifetime
    w.numbers("I", 0)
    w.numbers("B", 0)  # frame_locked
    w.sequence(tin.vertices[corners][inverse.ravel()])
    w.sequence(colour[inverse.ravel()])
    w.text("")  # texture_resource
    w.header(0, "")  # texture
    w.text("")
    w.sequence(np.zeros((0, 1), np.uint8))
    w.sequence(np.zeros((0, 2), np.float32))  # uv_coordinates
    w.text("")  # text
    w.text("")  # mesh_resource
    w.text("")  # mesh_file
    w.sequence(np.zeros((0, 1), np.uint8))
    w.numbers("B", 0)  # mesh_use_embedded_materials
    return w.bytes()


def ground_plane(estimate: Estimate, frame: str) -> bytes:
    """geometry_msgs/PoseWithCovarianceStamped: the base as a pose whose z axis is its normal, with
    the covariance of height and tilt.
    """
    base = estimate.base
    slope = base.beta[1:3] if len(base.beta) >= 3 else np.zeros(2)
    z = np.array([-slope[0], -slope[1], 1.0])
    z /= np.linalg.norm(z)
    x = np.array([1.0, 0.0, slope[0]])
    x /= np.linalg.norm(x)
    q = quaternion_from_matrix(np.column_stack([x, np.cross(z, x), z]))
    covariance = np.zeros((6, 6))
    if len(base.beta) >= 3 and base.C_beta.shape[0] >= 3:
        # height, rotation about x (slope in y), rotation about y (minus slope in x)
        J = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
        covariance[2:5, 2:5] = J @ base.C_beta[:3, :3] @ J.T
    w = Writer()
    w.header(estimate.volume.t_ns, frame)
    w.numbers("d", *map(float, base.origin_xy), float(base.beta[0]))
    w.numbers("d", *q.tolist())
    w.numbers("d", *covariance.ravel().tolist())
    return w.bytes()


def mesh(estimate: Estimate) -> bytes:
    """shape_msgs/Mesh: the relevant triangles with all vertices of the TIN."""
    tin = estimate.tin
    return mesh_of(tin.vertices, tin.triangles[tin.relevant])


def mesh_of(vertices: F64, triangles: npt.NDArray[Any]) -> bytes:
    """shape_msgs/Mesh of vertices (n, 3) m and triangles (m, 3)."""
    w = Writer()
    w.sequence(triangles.astype(np.uint32))
    w.sequence(vertices)
    return w.bytes()

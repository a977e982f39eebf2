"""Closed bodies as one mesh: in a file, or as arrays for a message."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ladar_volume.io.meshfiles.mesh_files import write_mesh
from ladar_volume.model.records import F64, I32, I64

if TYPE_CHECKING:  # for names of types alone
    from ladar_volume.clouds.body_volume import Body


def join_bodies(bodies: Sequence[Body]) -> tuple[F64, I32]:
    """Vertices (n, 3) m and triangles (m, 3) of all bodies, which may be none."""
    start = np.cumsum([0, *(len(b.skin.vertices) for b in bodies)])
    triangles = [b.closed.mesh.triangles + at for b, at in zip(bodies, start, strict=False)]
    return (
        np.concatenate([np.zeros((0, 3)), *(b.skin.vertices for b in bodies)]),
        np.concatenate([np.zeros((0, 3), np.int32), *triangles]).astype(np.int32),
    )


def write_bodies(path: Path, bodies: Sequence[Body]) -> None:
    """All bodies in one mesh file; in a PLY each vertex says what it is, and each face of which
    body it is and what closed it.
    """
    vertices, triangles = join_bodies(bodies)
    body = np.repeat(
        np.minimum(np.arange(len(bodies)), 255), [len(b.skin.triangles) for b in bodies]
    )
    kind: I64 = np.concatenate([b.skin.kind for b in bodies])
    notes = ["kind, closed: 0 measured, 1 edge completed, 2 gap, 3 on the ground"]
    face = {"closed": np.concatenate([b.skin.face for b in bodies]), "body": body.astype(np.int32)}
    write_mesh(path, vertices, triangles, notes, {"kind": kind.astype(np.int32)}, face)

"""Faces with more than three corners as triangles.

A convex face is a fan about its first corner; from one with a corner that points inward ears are
cut in its mean plane (Newell's normal), so that no triangle lies over another. A face whose corners
are in no plane says nothing about which diagonal holds: what depends on it is a doubt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ladar_volume.mesh.hole_filling import ears
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, I32, I64
from ladar_volume.model.verdict import Doubt

Faces = I32 | Sequence[Any]
#: Mean thickness of what lies between the diagonals of faces, as a part of their size, above which
#: it is a doubt.
BENT = 1e-3
#: A corner points inward where it turns by more than so much of a right angle.
INWARD = 1e-9


def by_corners(faces: Faces) -> dict[int, tuple[I64, I64]]:
    """Faces by their number of corners k: which they are (m,) and their corners (m, k). Raises
    :class:`InputError` (mesh_file_values) for fewer than three.
    """
    if isinstance(faces, np.ndarray) and faces.ndim == 2:
        whole = faces.astype(np.int64)
        found = {whole.shape[1]: (np.arange(len(whole), dtype=np.int64), whole)}
    else:
        lists: dict[int, list[int]] = {}
        for number, face in enumerate(faces):
            lists.setdefault(len(face), []).append(number)
        if lists and min(lists) < 3:
            raise InputError(f"a face with {min(lists)} corners", reason="mesh_file_values")
        found = {
            k: (
                np.array(numbers, np.int64),
                np.array([faces[n] for n in numbers], np.int64).reshape(-1, k),
            )
            for k, numbers in lists.items()
        }
    few = [k for k, (numbers, _) in found.items() if k < 3 and len(numbers)]
    if few:
        raise InputError(f"a face with {few[0]} corners", reason="mesh_file_values")
    return found


def check_index(groups: dict[int, tuple[I64, I64]], many: int) -> None:
    """Raises :class:`InputError`: mesh_file_empty without faces, mesh_file_index for a corner that
    is none of ``many`` vertices.
    """
    corners = [c for _, c in groups.values() if c.size]
    if not corners:
        raise InputError("no face", reason="mesh_file_empty")
    low, high = min(int(c.min()) for c in corners), max(int(c.max()) for c in corners)
    if low < 0 or high >= many:
        raise InputError(
            f"a face names vertex {low if low < 0 else high} of {many}",
            reason="mesh_file_index",
            value=high,
        )


def newell(p: F64) -> F64:
    """Twice the vector areas (m, 3) m² of polygons (m, k, 3), about their first corners."""
    d = p - p[:, :1]
    out: F64 = np.cross(d, np.roll(d, -1, axis=1)).sum(axis=1)
    return out


def inward(p: F64, normal: F64) -> F64:
    """Which of polygons (m, k, 3) have a corner that points inward, (m,) bool."""
    before, after = p - np.roll(p, 1, axis=1), np.roll(p, -1, axis=1) - p
    turn = np.einsum("mki,mi->mk", np.cross(before, after), normal)
    size = np.linalg.norm(before, axis=2) * np.linalg.norm(after, axis=2)
    return np.asarray((turn < -INWARD * size * np.linalg.norm(normal, axis=1)[:, None]).any(axis=1))


def cut_ears(p: F64, normal: F64) -> I64:
    """Triangles (k − 2, 3) of a polygon (k, 3), as numbers of its corners."""
    unit = normal / max(float(np.linalg.norm(normal)), 1e-300)
    u = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    u /= max(float(np.linalg.norm(u)), 1e-300)
    d = p - p[0]
    return ears(np.stack([d @ u, d @ np.cross(unit, u)], axis=1), np.arange(len(p)), [])[0]


def triangulate_faces(vertices: F64, faces: Faces) -> tuple[I32, tuple[Doubt, ...]]:
    """Triangles (m, 3) of faces over vertices (n, 3), in the order of the faces, and the doubt
    about faces that are not plane.

    Raises :class:`InputError`: mesh_file_values, mesh_file_empty, mesh_file_index.
    """
    groups = by_corners(faces)
    check_index(groups, len(vertices))
    owner, triangles = [], []
    between = size = 0.0
    uneven = 0
    for k, (numbers, corners) in groups.items():
        fan = np.stack([[0, i, i + 1] for i in range(1, k - 1)])
        made = corners[:, fan]
        if k > 3 and len(corners):
            p = vertices[corners]
            normal = newell(p)
            for row in np.flatnonzero(inward(p, normal)):
                made[row] = corners[row][cut_ears(p[row], normal[row])]
            middle = p.mean(axis=1)
            unit = normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
            off = np.abs(np.einsum("mki,mi->mk", p - middle[:, None], unit)).max(axis=1)
            area = 0.5 * np.linalg.norm(normal, axis=1)
            between, size = between + float(off @ area), size + float(area @ np.sqrt(area))
            uneven += int(np.count_nonzero(off > BENT * np.sqrt(area)))
        owner.append(np.repeat(numbers, k - 2))
        triangles.append(made.reshape(-1, 3))
    order = np.argsort(np.concatenate(owner), kind="stable")
    out = np.concatenate(triangles)[order].astype(np.int32)
    if between <= BENT * size:
        return out, ()
    text = (
        f"{uneven:,} faces have more than three corners in no plane: which diagonal holds is not "
        f"said, and up to {between:.3g} m³ lie between them; export triangles"
    )
    return out, (Doubt("mesh_bent_faces", text, between),)

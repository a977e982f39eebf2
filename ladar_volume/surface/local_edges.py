"""Sharp edges put back: no point of a scan lies on an edge, so a mesh through points cuts every edge off by a strip of chamfer triangles.

An edge of the mesh whose ends face different ways crosses a sharp edge of the body. It gets a vertex where the tangent planes of its ends
meet, and a triangle whose three corners lie on three faces one where all three planes meet (Attene et al. 2005, "Sharpen and bend").
Concave edges gain by the same. Edges of a rim stay as they are.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ladar_volume.model.records import F64, I32, I64, Bool
from ladar_volume.surface.local import ADDED, LocalMesh
from ladar_volume.surface.topology import edge_table

#: Normals that enclose more than this belong to two faces (cosine of 30 degrees), and when three planes still meet in a point.
SHARP, TRIPLE = 0.866, 0.2
#: A new vertex lies no farther from the middle of what it divides than this part of its length.
FAR = 1.0


def complete_edges(mesh: LocalMesh) -> LocalMesh:
    """The mesh with its sharp edges put back: vertices of status ADDED follow the points, and triangles across an edge are divided.

    The rims stay; report: added_vertices.
    """
    p, n, t = mesh.vertices, mesh.normals, mesh.triangles
    order, start, key = edge_table(t)
    ends = np.stack([key >> 32, key & 0xFFFFFFFF], axis=1)[order[start[:-1]]]
    at, good = meeting_points(p[ends], n[ends])
    good &= np.diff(start) == 2
    number = np.full(len(ends), -1, np.int64)
    number[good] = len(p) + np.arange(int(good.sum()))
    of_half = np.empty(len(order), np.int64)
    of_half[order] = np.repeat(number, np.diff(start))
    middle = of_half.reshape(-1, 3)
    three = np.flatnonzero(np.all(middle >= 0, axis=1))
    corner, fits = corner_points(p[t[three]], n[t[three]])
    three, corner = three[fits], corner[fits]
    centre = np.full(len(t), -1, np.int64)
    centre[three] = len(p) + int(good.sum()) + np.arange(len(three))
    vertices = np.concatenate([p, at[good], corner])
    normals = np.concatenate([n, unit(n[ends[good]].sum(axis=1)), unit(n[t[three]].sum(axis=1))])
    triangles, parent = divide(t, middle, centre, vertices)
    return dataclasses.replace(
        mesh, vertices=vertices, normals=normals, triangles=triangles, votes=mesh.votes[parent],
        status=np.append(mesh.status, np.full(len(vertices) - len(p), ADDED, np.int32)),
        report=mesh.report | {"added_vertices": len(vertices) - len(p)},
    )  # fmt: skip


def unit(v: F64) -> F64:
    """Vectors (k, 3) of length 1."""
    out: F64 = v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-300)
    return out


def meeting_points(p: F64, n: F64) -> tuple[F64, Bool]:
    """For pairs of points and normals (k, 2, 3) the point of the line where their planes meet that is nearest to their middle, and where
    there is one: normals that differ, and the point not far off."""
    dot = np.einsum("ki,ki->k", n[:, 0], n[:, 1])
    middle = p.mean(axis=1)
    # heights of both planes over the middle, which are made up by steps along both normals
    h = np.einsum("kji,kji->kj", p - middle[:, None], n)
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (h - dot[:, None] * h[:, ::-1]) / (1.0 - dot**2)[:, None]
    step = np.einsum("kj,kji->ki", s, n)
    length = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(step, axis=1) <= FAR * length
    # back to back sheets do not meet in an edge
    return middle + step, (dot < SHARP) & (dot > -SHARP) & near


def corner_points(p: F64, n: F64) -> tuple[F64, Bool]:
    """For triples of points and normals (k, 3, 3) where the three planes meet, and whether they do so near the triangle."""
    good = np.abs(np.linalg.det(n)) > TRIPLE
    at = p.mean(axis=1)
    middle = at[good]
    h = np.einsum("kji,kji->kj", p[good] - middle[:, None], n[good])
    at[good] += np.linalg.solve(n[good], h[:, :, None])[:, :, 0]
    length = np.linalg.norm(p - np.roll(p, 1, axis=1), axis=2).max(axis=1)
    return at, good & (np.linalg.norm(at - p.mean(axis=1), axis=1) <= FAR * length)


def divide(t: I32, middle: I64, centre: I64, v: F64) -> tuple[I32, I64]:
    """Triangles (m, 3) divided at the vertices on their edges (m, 3), -1 for none (edge k joins corners k and k + 1), and about the vertex
    in their middle, -1 for none; and which triangle each is a part of."""
    count = np.sum(middle >= 0, axis=1)
    keep = np.flatnonzero(count == 0)
    parts, parents = [t[keep]], [keep]

    def put(rows: I64, *corners: I64) -> None:
        parts.append(np.stack(corners, axis=1))
        parents.append(rows)

    for k in range(3):
        a, b, c = (t[:, (k + j) % 3].astype(np.int64) for j in range(3))
        ab, bc, ca = (middle[:, (k + j) % 3] for j in range(3))
        one = np.flatnonzero((count == 1) & (ab >= 0))
        put(one, a[one], ab[one], c[one])
        put(one, ab[one], b[one], c[one])
        two = np.flatnonzero((count == 2) & (bc < 0))  # a is alone on its side
        put(two, a[two], ab[two], ca[two])
        short = np.linalg.norm(v[ab[two]] - v[c[two]], axis=1) <= np.linalg.norm(v[ca[two]] - v[b[two]], axis=1)
        x, y = two[short], two[~short]
        put(x, ab[x], b[x], c[x])
        put(x, ab[x], c[x], ca[x])
        put(y, ab[y], b[y], ca[y])
        put(y, b[y], c[y], ca[y])
        flat = np.flatnonzero((count == 3) & (centre < 0))
        put(flat, a[flat], ab[flat], ca[flat])
        if k == 0:
            put(flat, ab[flat], bc[flat], ca[flat])
        full = np.flatnonzero(centre >= 0)
        put(full, a[full], ab[full], centre[full])
        put(full, ab[full], b[full], centre[full])
    return np.concatenate(parts).astype(np.int32), np.concatenate(parents)

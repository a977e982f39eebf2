"""Closed meshes with known volumes."""

import numpy as np

CUBE_V = np.array([[x, y, z] for z in (0.0, 1) for y in (0.0, 1) for x in (0.0, 1)])
CUBE_T = np.array(
    [
        [0, 2, 1],
        [1, 2, 3],
        [4, 5, 6],
        [5, 7, 6],
        [0, 1, 4],
        [1, 5, 4],
        [2, 6, 3],
        [3, 6, 7],
        [0, 4, 2],
        [2, 4, 6],
        [1, 3, 5],
        [3, 7, 5],
    ]
)


def grid_mesh(rows, columns, place, twist=0):
    """A mesh over a periodic grid: place(i, j) -> (x, y, z); torus, Klein-like with a reversed seam
    where ``twist``.
    """
    v = np.array([place(i, j) for i in range(rows) for j in range(columns)])
    t = []
    for i in range(rows):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            if i + 1 < rows or not twist:
                c, d = (i + 1) % rows * columns + j, (i + 1) % rows * columns + (j + 1) % columns
            else:
                c, d = (-j) % columns, (-j - 1) % columns
            t += [[a, b, c], [b, d, c]]
    return v, np.array(t)


def torus(rows=40, columns=24, R=2.0, r=0.6, twist=0):
    def place(i, j):
        a, b = 2 * np.pi * i / rows, 2 * np.pi * j / columns
        return [(R + r * np.cos(b)) * np.cos(a), (R + r * np.cos(b)) * np.sin(a), r * np.sin(b)]

    return grid_mesh(rows, columns, place, twist)


def moebius():
    """A strip of 24 triangles with one side only."""
    n = 12
    a = 2 * np.pi * np.arange(n) / n
    rim = [
        np.stack(
            [
                (2 + s * np.cos(a / 2)) * np.cos(a),
                (2 + s * np.cos(a / 2)) * np.sin(a),
                s * np.sin(a / 2),
            ],
            axis=1,
        )
        for s in (-0.5, 0.5)
    ]
    t = []
    for i in range(n):
        j = (i + 1) % n
        low, high = (j, n + j) if j else (n, 0)
        t += [[i, low, n + i], [low, high, n + i]]
    return np.concatenate(rim), np.array(t)


def sphere(n=2000, radius=1.0, rng=None):
    """A convex mesh through points on a sphere, evenly spread or random, from the package's own
    spherical triangulation with its gap closed.
    """
    from ladar_volume.change.spherical_tin import build_spherical

    k = np.arange(n)
    z, turn = 1 - 2 * (k + 0.5) / n, k * 2.399963229728653
    if rng is not None:
        z, turn = rng.uniform(-1, 1, n), rng.uniform(0, 2 * np.pi, n)
    s = np.sqrt(1 - z * z)
    v = radius * np.stack([s * np.cos(turn), s * np.sin(turn), z], axis=1)
    tin = build_spherical(v, np.zeros(3), gap_map=np.array([0.0, 0, 1])).tin
    hull = [
        (t[(k + 1) % 3], t[(k + 2) % 3])
        for t, nb in zip(tin.triangles, tin.neighbours, strict=True)
        for k in range(3)
        if nb[k] < 0
    ]
    after = dict(hull)
    loop = [hull[0][0]]
    while after[loop[-1]] != loop[0]:
        loop.append(after[loop[-1]])
    fan = [[loop[i + 1], loop[i], loop[0]] for i in range(1, len(loop) - 1)]
    return tin.vertices, np.concatenate([tin.triangles, np.array(fan, np.int32)])

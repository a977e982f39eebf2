"""The toe of a flat pile goes on along its slope to the ground; an eave, as flat, ends in the air
above a wall that was not seen.
"""

import numpy as np
import pytest

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.mesh.closing import close
from ladar_volume.mesh.linear_mesh import linear_mesh
from ladar_volume.mesh.tetrahedra import closed_volume

LEVEL = design_surface([0.0])
#: Corners of the pile in plan, its height and the radius of its foot, m: a slope of 20 degrees.
CORNERS, HEIGHT, FOOT = 24, 0.4, 1.1


def pile(cut, lift=0.0):
    """Vertices and triangles of a pyramid seen down to the height ``cut``, then lifted, m."""
    angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
    level = np.linspace(HEIGHT, cut, 6)[1:]
    r = FOOT * (1 - level / HEIGHT)
    rings = [
        np.column_stack([a * np.cos(angle), a * np.sin(angle), np.full(CORNERS, z)])
        for a, z in zip(r, level, strict=True)
    ]
    v = np.concatenate([[[0.0, 0.0, HEIGHT]], *rings]) + np.array([0.0, 0.0, lift])
    i = np.arange(CORNERS)
    j = (i + 1) % CORNERS
    t = [np.column_stack([np.zeros_like(i), 1 + i, 1 + j])]
    for k in range(4):
        a, b = 1 + k * CORNERS, 1 + (k + 1) * CORNERS
        t += [np.column_stack([a + i, b + i, b + j]), np.column_stack([a + i, b + j, a + j])]
    return v, np.concatenate(t)


def area(r):
    return 0.5 * CORNERS * np.sin(2 * np.pi / CORNERS) * r * r


def closed(v, t, limit):
    out = v * [1.0, 1.0, 0.0]
    out /= np.maximum(np.linalg.norm(out, axis=1), 1e-12)[:, None]
    normals = HEIGHT * out + FOOT * np.array([0.0, 0.0, 1.0])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    skin, made = close(linear_mesh(v, t, normals, np.zeros(len(v), bool)), limit, LEVEL)
    return closed_volume(skin.vertices, skin.triangles).volume_m3, made[-1].doubt_m3


@pytest.mark.parametrize("cut", [0.02, 0.05])
def test_a_toe_goes_on_along_its_slope(cut):
    V, doubt = closed(*pile(cut), 1.0)
    whole = area(FOOT) * HEIGHT / 3
    assert V == pytest.approx(whole, rel=2e-3)
    r = FOOT * (1 - cut / HEIGHT)
    upright = whole - area(r) * (HEIGHT - cut) / 3 - area(r) * cut
    assert 1.0 < doubt / (upright / np.sqrt(3)) < 1.25  # and what bends


def test_an_eave_ends_in_the_air():
    cut, lift = 0.05, 1.5
    V, _ = closed(*pile(cut, lift), 3.0)
    r = FOOT * (1 - cut / HEIGHT)
    assert V == pytest.approx(area(r) * (HEIGHT - cut) / 3 + area(r) * (lift + cut), rel=1e-9)

"""The unseen foot of plane walls goes on as the part above it leans, and what noise does to that is
in the derivatives.
"""

import numpy as np
import pytest

from ladar_volume.ground.polynomial import design_surface
from ladar_volume.mesh.closing import close
from ladar_volume.mesh.edge_completion import sharpen
from ladar_volume.mesh.linear_mesh import linear_mesh
from ladar_volume.mesh.local_mesh import mesh_cloud
from ladar_volume.mesh.tetrahedra import closed_volume

LEVEL = design_surface([0.0])
#: Half the width at the top and height of a frustum, m, and how far its walls lean out a metre.
HALF, HEIGHT, LEAN = 0.8, 1.0, 0.2


def frustum(unseen, step=0.08, rng=None, noise=0.0):
    """Points and outward normals on the roof and walls of a frustum, seen down to ``unseen``."""
    i = np.arange(-HALF + step / 2, HALF, step)
    x, y = (a.ravel() for a in np.meshgrid(i, i))
    parts, normals = [np.c_[x, y, np.full(len(x), HEIGHT)]], [np.tile([0.0, 0.0, 1.0], (len(x), 1))]
    z = np.arange(HEIGHT - step / 2, unseen, -step)
    for turn in range(4):
        c, s = np.cos(turn * np.pi / 2), np.sin(turn * np.pi / 2)
        R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        along, level = (a.ravel() for a in np.meshgrid(i, z))
        out = HALF + LEAN * (HEIGHT - level)
        parts.append(np.c_[out, along * out / HALF, level] @ R.T)
        n = np.array([1.0, 0.0, LEAN]) / np.hypot(1.0, LEAN)
        normals.append(np.tile(R @ n, (len(level), 1)))
    p, n = np.concatenate(parts), np.concatenate(normals)
    return (p if rng is None else p + noise * rng.normal(size=(len(p), 1)) * n), n


def true_volume(half=HALF):
    """Of the frustum down to the ground."""
    a, b = (2 * half) ** 2, (2 * (half + LEAN * HEIGHT)) ** 2
    return HEIGHT / 3.0 * (a + b + np.sqrt(a * b))


def body(p, n, t):
    """The closed mesh and what was closed."""
    skin = linear_mesh(p, t, n, np.zeros(len(p), bool))
    return close(sharpen(skin)[0], 1.0, LEVEL)


def volume(skin):
    return closed_volume(skin.vertices, skin.triangles)


def test_leaning_walls_go_on_to_the_ground_and_the_doubt_is_that_they_stand_upright():
    p, n = frustum(0.3)
    mesh = mesh_cloud(p, n)
    skin, made = body(mesh.vertices, mesh.normals, mesh.triangles)
    assert volume(skin).volume_m3 == pytest.approx(true_volume(), rel=1e-9)
    low = 0.3 + 0.02  # of the lowest row
    a, b = (2 * (HALF + LEAN * (HEIGHT - low))), 2 * (HALF + LEAN * HEIGHT)
    less = low / 3.0 * (a * a + b * b + a * b) - a * a * low
    assert made[-1].doubt_m3 == pytest.approx(less, rel=0.06)


def test_normals_off_by_noise_do_not_make_walls_lean():
    p, n = frustum(0.3)
    mesh = mesh_cloud(p, n)
    rng = np.random.default_rng(2)
    off = mesh.normals + 0.03 * rng.normal(size=p.shape)
    off /= np.linalg.norm(off, axis=1)[:, None]
    skin = linear_mesh(mesh.vertices, mesh.triangles, off, np.zeros(len(p), bool))
    foot = close(skin, 1.0, LEVEL)[0]
    feet = foot.vertices[(foot.kind == 3) & (np.abs(foot.vertices[:, 1]) < 0.5)]
    feet = feet[feet[:, 0] > 0.9]
    assert len(feet) > 5 and feet[:, 0] == pytest.approx(HALF + LEAN * HEIGHT, abs=1e-3)


def test_derivatives_hold_the_lean():
    p, n = frustum(0.25, rng=np.random.default_rng(3), noise=0.004)
    mesh = mesh_cloud(p, n)
    skin = body(p, n, mesh.triangles)[0]
    gradient = np.asarray(volume(skin).gradient.ravel() @ skin.by_measured)
    rng = np.random.default_rng(4)
    for _ in range(4):
        # along the faces' own normals, which stay as they are
        d = 1e-6 * rng.normal(size=(len(p), 1)) * n
        plus, minus = (volume(body(p + s * d, n, mesh.triangles)[0]).volume_m3 for s in (1.0, -1.0))
        assert gradient @ d.ravel() == pytest.approx((plus - minus) / 2.0, rel=2e-3)
    # a wall that leans a little more: the foot moves on with it
    tilt = np.where((n[:, 0] > 0.5)[:, None], (p[:, 2:] - 0.6) * n, 0.0)
    plus, minus = (
        volume(body(p + s * 1e-6 * tilt, n, mesh.triangles)[0]).volume_m3 for s in (1.0, -1.0)
    )
    assert 1e-6 * gradient @ tilt.ravel() == pytest.approx((plus - minus) / 2.0, rel=2e-3)


def test_too_little_of_a_wall_does_not_tell_its_lean():
    p, n = frustum(0.85)  # two rows, to be drawn over 0.9 m
    mesh = mesh_cloud(p, n)
    rng = np.random.default_rng(5)
    at = p + 0.01 * rng.normal(size=(len(p), 1)) * n
    skin, _ = body(at, n, mesh.triangles)
    foot = skin.vertices[skin.kind == 3]
    assert np.abs(foot[:, :2]).max() < 1.15 * (HALF + LEAN * HEIGHT)

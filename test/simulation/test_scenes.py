"""Scenes: meshes hold the closed-form volumes."""

import numpy as np
import pytest

from ladar_volume.model.errors import SimulationError
from ladar_volume.simulation.scenes import (
    Ground,
    box_mesh,
    kern_pit,
    make_scene,
    mesh_volume,
    pile,
    sphere,
    square,
)


def volume_above_ground(scene, ground, radius):
    """Integral over the mesh of (z − ground) inside a radius: prisms under each triangle."""
    p = scene.vertices[scene.triangles]
    inside = (np.hypot(p[:, :, 0], p[:, :, 1]) <= radius).all(axis=1)
    p = p[inside]
    area = 0.5 * (
        (p[:, 1, 0] - p[:, 0, 0]) * (p[:, 2, 1] - p[:, 0, 1])
        - (p[:, 2, 0] - p[:, 0, 0]) * (p[:, 1, 1] - p[:, 0, 1])
    )
    h = p[:, :, 2] - ground(p[:, :, 0].ravel(), p[:, :, 1].ravel()).reshape(-1, 3)
    return float(np.sum(area * h.mean(axis=1)))


@pytest.mark.parametrize(
    ("a", "b", "top"), [(10.0, 10.0, 0.0), (11.0, 9.0, 0.25), (8.0, 12.0, 0.5)]
)
@pytest.mark.parametrize(
    "ground", [Ground(), Ground(2.0, (0.03, -0.02)), Ground(rough_m=0.02, seed=5)]
)
def test_piles_hold_their_volume_on_any_ground(a, b, top, ground):
    scene = pile("pile", a, b, top, ground)
    assert volume_above_ground(scene, ground, 30.0) == pytest.approx(scene.volume_m3, rel=1e-5)


def test_pile_volume_is_the_cone_of_the_handbook():
    scene = pile("cone", 10.0, 10.0, 0.0, Ground())
    height = 10.0 * np.tan(np.radians(35.0))
    assert scene.volume_m3 == pytest.approx(np.pi * 100.0 * height / 3.0)
    assert scene.vertices[:, 2].max() == pytest.approx(height)


def test_the_pit_of_seed_003_holds_16_cubic_metres():
    assert volume_above_ground(
        kern_pit(True), Ground(rough_m=0.03, length_m=0.8, seed=4), 9.0
    ) == pytest.approx(-16.0, rel=1e-5)
    assert kern_pit(False).vertices.shape == kern_pit(True).vertices.shape


def test_sphere_and_box_meshes_are_closed_and_exact():
    scene = sphere()
    body = scene.vertices[81 * 81 :]
    assert mesh_volume(body, scene.triangles[2 * 80 * 80 :] - 81 * 81) == pytest.approx(
        4 / 3 * np.pi, rel=1e-12
    )
    assert mesh_volume(*box_mesh(0, 3, 1, 2, -1, 4)) == pytest.approx(15.0, rel=1e-12)


def test_roughness_has_its_sd_its_mean_over_a_box_is_exact_and_the_seed_decides():
    ground = Ground(rough_m=0.01, length_m=1.0, seed=3)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-200, 200, (2, 40_000))
    assert np.std(ground(x, y)) == pytest.approx(0.01, rel=0.05)
    fine = np.linspace(-1.5, 1.5, 401), np.linspace(-1.0, 1.0, 401)
    gx, gy = np.meshgrid(*(0.5 * (e[1:] + e[:-1]) for e in fine))
    assert ground.mean_over_box(-1.5, 1.5, -1.0, 1.0) == pytest.approx(
        float(ground(gx, gy).mean()), abs=1e-7
    )
    assert not np.allclose(ground(x, y), Ground(rough_m=0.01, length_m=1.0, seed=4)(x, y))


def test_the_square_adds_up_and_unknown_scenes_are_refused():
    assert square().volume_m3 == pytest.approx(3 * 1.8 * 0.5 * 0.45 + np.pi * (16 - 3.6**2) * 0.5)
    assert make_scene("nist_box").volume_m3 == pytest.approx(1.2192 * 1.5240 * 0.9144)
    with pytest.raises(SimulationError, match="no scene 'moon'"):
        make_scene("moon")

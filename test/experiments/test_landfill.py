"""The simulated landfill excavation: exact bodies, spheres and rays in closed form, registration,
one body end to end, tables and figures.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from ladar_volume.cli import main as cli
from ladar_volume.experiments import landfill, landfill_scene
from ladar_volume.experiments.landfill_scene import (
    HEAD_M,
    LAYER_M,
    SMOOTH_M3,
    SPHERE_M,
    curve,
    directions,
    make_layer,
    scan,
    tacheometer,
    to_spheres,
)
from ladar_volume.experiments.landfill_tables import TABLES, tables
from ladar_volume.mesh.tetrahedra import signed_tetrahedra
from ladar_volume.mesh.topology import check_closed, orient
from ladar_volume.model.errors import SimulationError


@pytest.fixture(scope="module")
def coarse():
    """Half the angular resolution, a coarser cell: a quarter of the points, for the tests."""
    patch = pytest.MonkeyPatch()
    patch.setattr(landfill_scene, "STEP_RAD", np.radians(0.5))
    patch.setattr(landfill, "THIN_M", 0.06)
    patch.setattr(landfill, "CELLS_M", (0.15, 0.3))
    patch.setattr(landfill, "LAYERS", 1)
    yield
    patch.undo()


@pytest.fixture(scope="module")
def study(coarse):
    return landfill.run(1)


def test_both_surfaces_of_a_layer_enclose_the_body_exactly(monkeypatch):
    layer = make_layer(1, 3)
    (v_a, t_a), (v_b, t_b) = layer.before, layer.after
    n = np.flatnonzero((v_a[t_a] != v_b[t_b[: len(t_a)]]).any(axis=(1, 2)))[
        0
    ]  # what is outside they share
    vertices = np.concatenate([v_a, v_b])
    triangles = np.concatenate([t_a[n:], len(v_a) + t_b[n:][:, [0, 2, 1]]])
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    closed = orient(np.unique(vertices, axis=0), same.ravel()[triangles])
    check_closed(closed)
    for pole in (np.zeros(3), np.array([4.0, -7.0, 9.0])):
        assert float(signed_tetrahedra(vertices, triangles, pole).sum()) == pytest.approx(
            layer.volume_m3, abs=1e-9
        )
    assert layer.volume_m3 == pytest.approx(SMOOTH_M3, rel=0.03)
    # without rubble it is a prism that leans, whose volume is its plan area times its depth
    monkeypatch.setattr(landfill_scene, "RUBBLE", ())
    assert make_layer(1, 3).volume_m3 == pytest.approx(SMOOTH_M3, rel=1e-12)
    top = -LAYER_M
    assert [p[2] for p in layer.scanners] == pytest.approx(
        [top + HEAD_M[0], top - LAYER_M + HEAD_M[1]]
    )
    with pytest.raises(SimulationError):
        make_layer(3, 0)


def test_rows_wind_counter_clockwise_and_grid_covers_all_but_the_sky():
    row = curve(1.0, 0.5, 0.0)
    after = np.roll(row, -1, axis=0)
    assert ((row[:, 0] - 0.5) * after[:, 1] - row[:, 1] * (after[:, 0] - 0.5) > 0).all()
    rays = directions()
    assert (
        np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
        and rays[:, 2].max() < np.sin(np.radians(60)) + 1e-9
    )
    assert rays[:, 2].min() < -0.99999


def test_rays_meet_spheres_where_they_are():
    rng = np.random.default_rng(0)
    centres, origin = np.array([[3.0, 0, 0], [4.0, 0.1, 0], [0, 5, 1]]), np.array([0.1, -0.2, 0.05])
    rays = np.concatenate(
        [
            centres[rng.integers(0, 3, 300)] + rng.uniform(-0.15, 0.15, (300, 3)) - origin,
            [[-1.0, 0, 0]],
        ]
    )
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    distance, which = to_spheres(origin, rays, centres)
    hit = which >= 0
    at = origin + distance[hit, None] * rays[hit]
    assert np.linalg.norm(at - centres[which[hit]], axis=1) == pytest.approx(SPHERE_M)
    normal = (at - centres[which[hit]]) / SPHERE_M
    assert ((normal * rays[hit]).sum(axis=1) < 0).all()  # the near side
    assert not hit[-1] and 0.2 < hit.mean() < 0.9
    assert not np.isfinite(distance[~hit]).any()


def test_a_scan_without_noise_lies_on_the_surface_and_the_spheres(coarse):
    square = (
        np.array([[-9.0, -9, -2], [9, -9, -2], [9, 9, -2], [-9, 9, -2]]),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    spheres = np.array([[4.0, 0, 0.5], [0, -4.0, 0.3]])
    raw = scan(square, np.array([0.5, 0.2, 0.0]), spheres, np.random.default_rng(1), 0.0)
    c, s = np.cos(raw.heading_rad), np.sin(raw.heading_rad)
    back = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    surface = raw.surface @ back.T + raw.scanner_map
    assert surface[:, 2] == pytest.approx(-2.0, abs=1e-5) and np.abs(surface[:, :2]).max() < 9.01
    on = raw.on_spheres @ back.T + raw.scanner_map
    assert np.linalg.norm(on - spheres[raw.sphere], axis=1) == pytest.approx(SPHERE_M, abs=1e-9)
    points, number = tacheometer(spheres, np.array([10.0, 0, 1.6]), np.random.default_rng(2))
    assert (
        np.bincount(number).tolist() == [14, 14]
        and np.abs(np.linalg.norm(points - spheres[number], axis=1) - SPHERE_M).max() < 0.012
    )


def test_one_body_end_to_end(study):
    body = study.bodies[0][0]
    assert (
        abs(body.excavation.removed_m3 - body.true_m3)
        < 4 * body.excavation.sigma_m3
        < 0.01 * body.true_m3
    )
    assert body.excavation.between.pole_spread_m3 < 1e-9 * body.true_m3
    # of six spheres four are used: two are hidden or left out before, the one knocked over is found
    # after
    assert body.used[0] == [0, 1, 2, 3] and body.used[1] == [0, 1, 3, 4]
    assert body.excavation.published_m3 / body.true_m3 > 1.005  # each over its own boundary
    assert body.rho.density_kg_m3 == pytest.approx(body.true_kg_m3, rel=0.01)
    assert sum(body.excavation.budget_m6.values()) == pytest.approx(body.excavation.sigma_m3**2)
    shares = landfill.size_shares(body)
    assert shares["offset"] > 3 * shares["height"] > 10 * shares["noise"]


def test_tables_and_figures_have_every_number(study, tmp_path, monkeypatch, capsys):
    whole = landfill.Study([[study.bodies[0][0]] * 3] * 2, study.resolution)
    text = tables(whole)
    assert (
        all(f"## {name}" in text for name in TABLES) and "16 (body #2)" in text and "100 m³" in text
    )
    assert "nan" not in text
    monkeypatch.setattr(landfill, "run", lambda seeds, progress: whole)
    monkeypatch.setattr(
        "ladar_volume.experiments.landfill_tables.profiles",
        lambda _: __import__("matplotlib.figure").figure.Figure(),
    )
    assert (
        cli.main(["study", "landfill", "--seeds", "1", "-o", str(tmp_path / "out"), "--json"]) == 0
    )
    facts = json.loads(capsys.readouterr().out)
    assert facts["study"] == "landfill" and facts["bodies"] == 6 and facts["pole_spread"] < 1e-9
    assert (
        facts["watertight"] is True
        and len(facts["volume_m3"]) == len(facts["sigma_m3"]) == len(facts["closed_m3"]) == 6
    )
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "errors.png",
        "resolution.png",
        "section.png",
        "study.json",
        "tables.md",
    ]
    assert cli.main(["study", "landfill", "--seeds", "1"]) == 0
    assert "predicted sigma" in capsys.readouterr().out


def test_no_seed_is_refused(capsys):
    assert cli.main(["study", "landfill", "--seeds", "0"]) == 2
    assert "one seed or more" in capsys.readouterr().err

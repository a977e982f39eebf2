"""Chapter 9 of the thesis repeated: the clouds lie where they should, both ways run, tables and
figure hold every number.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from matplotlib.image import imread

from ladar_volume.cli import main as cli
from ladar_volume.clouds.published.filter_presets import preset
from ladar_volume.experiments import thesis, thesis_figures, thesis_tables
from ladar_volume.experiments import thesis_scene as scene
from ladar_volume.experiments.nist.nist_figures import panels
from ladar_volume.mesh.local_mesh import BOX
from ladar_volume.model.errors import SimulationError


@pytest.fixture(scope="module")
def study():
    patch = pytest.MonkeyPatch()
    patch.setattr(scene, "bench", lambda seed, make=scene.bench: make(seed, 6000))
    found = thesis.run(1, 4000)
    patch.undo()
    return found


def test_clouds_lie_on_their_surfaces():
    for make, count in (
        (scene.box, scene.BOX_POINTS),
        (scene.sphere, scene.SPHERE_POINTS),
        (scene.box_on_ground, scene.BOX_POINTS),
    ):
        points = make(3)
        assert (
            points.shape == (count + scene.OUTLIERS, 3)
            and np.array_equal(points, make(3))
            and not np.array_equal(points, make(4))
        )
    off = np.abs(np.linalg.norm(scene.sphere(0), axis=1) - 1.0)
    assert (off <= scene.NOISE_M).sum() >= scene.SPHERE_POINTS and (off > scene.NOISE_M).sum() > 50
    p = scene.box(0) - [0.0, 0.0, 0.5]
    outside = np.linalg.norm(np.maximum(np.abs(p) - 0.5, 0.0), axis=1)
    inside = 0.5 - np.abs(p).max(axis=1)
    near = np.where(outside > 0, outside, inside) <= scene.NOISE_M
    assert near.sum() >= scene.BOX_POINTS and np.abs(p.mean(axis=0)).max() < 0.03
    # all six faces alike
    face = np.argmax(np.abs(p[near]), axis=1) + 3 * (
        p[near][np.arange(near.sum()), np.argmax(np.abs(p[near]), axis=1)] > 0
    )
    assert np.bincount(face, minlength=6).min() > 0.9 * scene.BOX_POINTS / 6


def test_points_are_even_over_a_mesh():
    v, t = scene.cube_mesh(True)
    at, normals = scene.on_mesh(v, t, 60_000, np.random.default_rng(1))
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0)
    assert ((at - [0, 0, 0.5]) * normals).sum(axis=1) == pytest.approx(0.5)  # outward, on a face
    counts = np.histogram2d(at[normals[:, 2] > 0.5, 0], at[normals[:, 2] > 0.5, 1], bins=4)[0]
    assert counts.min() > 0.85 * 10_000 / 16 and counts.max() < 1.15 * 10_000 / 16
    assert len(scene.cube_mesh(False)[1]) == 10


def test_the_window_of_bench_and_fountain_has_the_printed_density():
    size = (scene.BENCH_HIGH - scene.BENCH_LOW).prod()
    assert scene.BENCH_POINTS / size == pytest.approx(3680, rel=0.002)
    points = scene.bench(0, 3000)
    assert (
        len(points) == 3100
        and ((points[:, 1] > 5.7) & (np.abs(points[:, 2] - 0.45) < 0.06)).sum() > 30
    )  # the bench
    assert ((points[:, 1] < -1.0) & (np.abs(points[:, 2] - 0.5) < 0.06)).sum() > 5  # the ring
    with pytest.raises(SimulationError):
        scene.square(10)


def test_both_ways_measure_cube_and_sphere(study):
    for bodies, truth in ((study.boxes, scene.BOX_M3), (study.spheres, scene.SPHERE_M3)):
        error = {way: float(e[0]) for way, e in thesis.errors_pct(bodies, truth).items()}
        assert (
            abs(error["own way"]) < 0.8 and error["own way, not corrected"] < error["own way"] + 0.3
        )
        assert all(abs(error[way]) < 20 for way in error) and error["remove"] < -5
        own, modes = bodies[0].own, bodies[0].modes
        assert own.watertight and own.euler == 2 and own.triangles == 2 * own.vertices - 4
        assert (
            modes["none"].over_full > 50 > modes["false"].over_full
            and modes["remove"].over_full == 0
        )
        assert (
            modes["remove"].triangles
            < modes["false"].triangles
            < modes["none"].triangles
            <= modes["empty"].triangles
        )
    assert all(abs(f.height_m) < 0.02 and f.tilt_rad < 0.02 for f in study.fields.values())
    assert (
        all(f.over_full == 0 for name, f in study.fields.items() if "own way" in name)
        and len(study.fields) == 4
    )


def test_tables_figure_and_verb(study, tmp_path, monkeypatch, capsys):
    text = thesis_tables.tables(study)
    assert all(
        f"{count}" in text
        for count, _ in [*thesis_tables.TABLE_9_3.values(), *thesis_tables.TABLE_9_4.values()]
    )
    assert (
        "+0.12" in text and "-2.85" in text and "nan" not in text
    )  # the misprint of Table 9.3 is not repeated
    monkeypatch.setattr(thesis, "run", lambda seeds, large, progress: study)
    monkeypatch.setattr(thesis_figures, "write_figures", lambda folder, large: [])
    words = ["--seeds", "1", "--large", "2000", "-o", str(tmp_path / "out"), "--json"]
    assert cli.main(["study", "thesis", *words]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (
        facts["box"]["volume_m3"] == pytest.approx([1.0], abs=0.01)
        and 0.001 < facts["box"]["sigma_m3"][0] < 0.01
    )
    assert facts["box"]["watertight"] is True and facts["sphere"]["euler"] == [2]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "study.json",
        "tables.md",
        "volumes.png",
    ]
    assert cli.main(["study", "thesis", "--seeds", "1"]) == 0
    assert "own way" in capsys.readouterr().out


def test_every_figure_is_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(scene, "BOX_POINTS", 1500)
    made = thesis_figures.cloud(scene.box_on_ground(0), preset("box"), BOX)
    low = made.filtered[made.on_ground]
    assert len(low) > 300 and np.abs(low[:, 2]).max() < 0.06
    # one of the clouds stands for all
    monkeypatch.setattr(thesis_figures, "cloud", lambda *words: made)
    monkeypatch.setattr(scene, "bench", lambda seed: made.raw)
    monkeypatch.setattr(scene, "square", lambda count: made.raw)
    names = thesis_figures.write_figures(tmp_path, 2000)
    assert names == [f"figure_9_{k}.png" for k in range(2, 17)]
    for name in names:
        shades = imread(tmp_path / name)[:, :, :3]
        assert (shades < 0.9).any(axis=2).mean() > 0.004, name  # something stands on the page
    assert thesis_figures.camera() @ thesis_figures.camera().T == pytest.approx(np.eye(3))


def test_the_nearest_is_drawn_last():
    draws, towards = [], thesis_figures.camera()[2]
    for r in (np.array([np.zeros(3), towards]), np.array([towards, np.zeros(3)])):
        _, axes = panels(1, 1)
        thesis_figures.draw_points(r, None, "two", axes[0, 0])
        draws.append(axes[0, 0].collections[0].get_array())
    assert np.allclose(draws[0], draws[1]) and draws[0][-1] > draws[0][0]


def test_refusals(capsys):
    assert cli.main(["study", "thesis", "--seeds", "0"]) == 2
    assert "one seed or more" in capsys.readouterr().err

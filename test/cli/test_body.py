"""``ladar_volume body`` on files: clouds, meshes, ground, regions, JSON, refusals."""

import contextlib
import io
import json

import numpy as np
import pytest
from closed_meshes import CUBE_T, CUBE_V, moebius, sphere

from benchmarks.body_coverage import KINDS, ask
from ladar_volume.cli.body_facts import quantity
from ladar_volume.cli.main import main
from ladar_volume.clouds.body_points import ExcludedPoints, step_between
from ladar_volume.clouds.body_verdict import (
    bodies_verdict,
    check_missed,
    filter_doubts,
    missed_points,
    touches_outline,
)
from ladar_volume.clouds.cloud_bodies import cloud_bodies
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.experiments import thesis, thesis_scene
from ladar_volume.ground.objects import find_objects
from ladar_volume.ground.polynomial import design_surface
from ladar_volume.io.meshfiles.mesh_files import holds_faces, read_mesh, write_mesh
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.io.pointfiles.ply_elements import read_header
from ladar_volume.mesh.local_mesh import BOX, SPHERE
from ladar_volume.mesh.topology import orient
from ladar_volume.model.body_parameters import ObjectParameters
from ladar_volume.model.choices import REPAIRS
from ladar_volume.model.errors import ObjectError


def boxes(rng, places, count=3500, noise=0.01):
    """Unit cubes without bottom on a ground of 6 x 3 m."""
    n = 18 * count // 5
    parts = [np.column_stack([rng.uniform([-1.5, -1.5], [4.5, 1.5], (n, 2)), np.zeros(n)])]
    keep = np.ones(n, bool)
    for x in places:
        keep &= (np.abs(parts[0][:, 0] - x) > 0.5) | (np.abs(parts[0][:, 1]) > 0.5)
        for axis, side in ((0, -0.5), (0, 0.5), (1, -0.5), (1, 0.5), (2, 0.5)):
            face = np.insert(rng.uniform(-0.5, 0.5, (count // 5, 2)), axis, side, axis=1)
            parts.append(face + np.array([x, 0, 0.5]))
    parts[0] = parts[0][keep]
    p = np.concatenate(parts)
    return p + noise * rng.normal(size=p.shape)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    path = tmp_path_factory.mktemp("body") / "cubes.ply"
    write_cloud(path, boxes(np.random.default_rng(0), (0.0, 3.0)))
    return path


def answer(capsys, *words):
    assert main(["body", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_two_cubes_on_the_ground(cloud, tmp_path, capsys):
    out = tmp_path / "bodies.ply"
    facts = answer(capsys, cloud, "-o", out)
    assert len(facts["bodies"]) == 2 and facts["watertight"] is True
    for body in facts["bodies"]:
        assert body["volume_m3"] == pytest.approx(1.0, abs=0.02) and body["euler"] == 2
        assert (
            0.0 < body["sigma_m3"] < 0.01
            and body["closed_m3"] > 0.0
            and body["closures"][0]["on"] == "ground"
        )
        assert abs(body["pole_spread_m3"]) < 1e-12 and body["mesh"]["points"] > 500
    assert facts["volume_m3"] == pytest.approx(sum(b["volume_m3"] for b in facts["bodies"]))
    assert facts["uncorrected_m3"] < facts["volume_m3"] and facts["ground"]["points"] > 1000
    assert np.sqrt(np.sum(facts["covariance_m6"])) == pytest.approx(facts["sigma_m3"])
    # the verb reads what it wrote; curvature needs the normals, which a mesh file has not
    curvature = sum(b["curvature_m3"] for b in facts["bodies"])
    for name in ("again.ply", "again.stl"):
        again = answer(capsys, out, "-o", tmp_path / name)
        assert again["volume_m3"] == pytest.approx(facts["volume_m3"] - curvature, rel=1e-6)
        assert again["watertight"] and len(again["bodies"][0]["closures"]) == 0
        out = tmp_path / name
    out = tmp_path / "bodies.ply"
    mesh = read_mesh(out)
    assert len(orient(mesh.vertices, mesh.triangles).boundary) == 0
    with out.open("rb") as file:
        elements = read_header(file).elements
    names = {e.name: [p.name for p in e.properties] for e in elements}
    assert names["vertex"][-1] == "kind" and names["face"][-2:] == ["closed", "body"]


@pytest.mark.parametrize("seed", [20, 22])
def test_the_toe_of_a_flat_pile_is_part_of_it(seed, tmp_path, capsys):
    """Cut off where it meets the noise of the ground, V would be 0.6 to 0.9 % low, at a sigma of
    0.3 %.
    """
    rng = np.random.default_rng(seed)
    rng.choice(3)
    foot, height = rng.uniform(0.8, 1.6), rng.uniform(0.4, 1.0)
    q, angle = foot * np.sqrt(rng.uniform(0, 1, 3000)), rng.uniform(0, 2 * np.pi, 3000)
    top = np.column_stack([q * np.cos(angle), q * np.sin(angle), height * (1 - q / foot)])
    level = np.column_stack([rng.uniform(-4, 4, (9000, 2)), np.zeros(9000)])
    p = np.concatenate([top, level[np.hypot(level[:, 0], level[:, 1]) > foot]])
    write_cloud(tmp_path / "pile.ply", p + rng.normal(0, 0.01, p.shape))
    facts = answer(capsys, tmp_path / "pile.ply", "-o", tmp_path / "body.ply")
    true = np.pi * foot**2 * height / 3
    assert facts["volume_m3"] == pytest.approx(true, rel=0.004)
    assert abs(facts["volume_m3"] - true) < 2.0 * facts["sigma_m3"] < 0.03 * true


def test_one_body_by_region_or_pick(cloud, tmp_path, capsys):
    out = tmp_path / "one.ply"
    whole = answer(capsys, cloud, "-o", out, "--box=-1,-1,-1,1,1,2")
    pick = answer(capsys, cloud, "-o", out, "--pick=0,0,1")
    assert len(whole["bodies"]) == len(pick["bodies"]) == 1
    assert whole["volume_m3"] == pytest.approx(pick["volume_m3"]) == pytest.approx(1.0, abs=0.02)
    given = answer(capsys, cloud, "-o", out, "--pick=0,0,1", "--ground", "0")
    assert (
        given["volume_m3"] == pytest.approx(whole["volume_m3"], abs=0.005)
        and given["ground"]["points"] == 0
    )
    polygon = answer(capsys, cloud, "-o", out, "--polygon", "2,-1", "4,-1", "4,1", "2,1")
    assert len(polygon["bodies"]) == 1 and polygon["bodies"][0]["centroid_map_m"][
        0
    ] == pytest.approx(3.0, abs=0.02)


def test_filtered_points_as_they_are(tmp_path, capsys):
    v, _ = sphere(1500)
    path, out = tmp_path / "ball.csv", tmp_path / "ball.obj"
    write_cloud(path, v, {"normal": v, "sigma": np.full(len(v), 0.001)})
    facts = answer(capsys, path, "-o", out, "--no-filter", "--ground", "none")
    assert facts["volume_m3"] == pytest.approx(4 / 3 * np.pi, rel=1e-4) and facts["filter"] is None
    assert facts["uncorrected_m3"] < facts["volume_m3"] and facts["sigma_m3"] == pytest.approx(
        0.001 * 4 * np.pi / np.sqrt(1500), rel=0.1
    )
    assert read_mesh(out).triangles.shape == (2996, 3)


def test_meshes_closed_open_and_refused(tmp_path, capsys):
    whole, hollow, out = tmp_path / "cube.off", tmp_path / "cup.stl", tmp_path / "o.ply"
    write_mesh(whole, CUBE_V, CUBE_T)
    write_mesh(hollow, CUBE_V, CUBE_T[2:])
    facts = answer(capsys, whole, "-o", out, "--pole=5,5,5", "--sigma", "0.001")
    assert (
        facts["volume_m3"] == pytest.approx(1.0)
        and facts["closed_m3"] == 0
        and facts["sigma_m3"] > 0
    )
    assert facts["bodies"][0]["pole_map_m"] == [5, 5, 5]
    facts = answer(capsys, hollow, "-o", out, "--ground=-0.1", "--close", "0.2")
    assert (
        facts["volume_m3"] == pytest.approx(1.1)
        and facts["closed_m3"] == pytest.approx(0.1)
        and facts["sigma_m3"] is None
    )
    again = answer(capsys, out, "-o", tmp_path / "again.ply")
    assert again["volume_m3"] == pytest.approx(1.1) and holds_faces(out)
    for words, say in (
        ((hollow, "-o", out), "--close"),
        ((hollow, "-o", out, "--ground=-0.5", "--close", "0.2"), "above the ground"),
        ((whole, "-o", whole), "different files"),
        ((whole, "-o", tmp_path / "o.txt"), "no known kind"),
        ((whole, "-o", out, "--pick=0,0,0"), "is a mesh"),
        ((tmp_path / "none.ply", "-o", out), "none.ply"),
        ((whole, "-o", out, "--close=-1"), "from 0 up"),
    ):
        assert main(["body", *map(str, words)]) == 2
        assert say in capsys.readouterr().err


def test_what_a_person_sees(cloud, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["body", str(cloud), "-o", str(tmp_path / "o.ply")]) == 0
    seen = capsys.readouterr().out
    for words in (
        "uncorrected",
        "closed on the ground",
        "edges completed",
        "watertight: yes",
        "all",
    ):
        assert words in seen


def test_the_table_is_whole_at_80_columns(cloud, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["body", str(cloud), "-o", str(tmp_path / "o.ply")]) == 0
    seen = capsys.readouterr().out
    places = [line for line in seen.splitlines() if line.startswith(("body 1 at", "body 2 at"))]
    assert "…" not in seen and len(places) == 2 and all(line.endswith(" m") for line in places)


def test_contradictions_of_a_cloud_are_refused(cloud, tmp_path, capsys):
    out = str(tmp_path / "o.ply")
    for words, say in (
        (["--box=0,0,0,1,1,1", "--pick=0,0,0"], "choose one"),
        (["--no-filter", "--radius", "1"], "--no-filter"),
        (["--box=10,10,10,11,11,11"], "nothing rises"),
    ):
        assert main(["body", str(cloud), "-o", out, *words]) == 2
        assert say in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["body", str(cloud), "-o", out, "--ground", "1,2"])


def refusal(capsys, *words):
    """What the verb says, in one line."""
    assert main(["body", *map(str, words)]) == 2
    out, err = capsys.readouterr()
    assert err.startswith("ladar_volume: ") and err.count("\n") == 1 and "watertight" not in out
    return err


def inner_wall():
    """Two cubes in one, with the face between them there once."""
    v = np.concatenate([CUBE_V, CUBE_V[CUBE_V[:, 0] == 1] + [1, 0, 0]])
    number = {tuple(p): k for k, p in enumerate(v)}
    second = [[number[tuple(CUBE_V[k] + [1, 0, 0])] for k in t] for t in CUBE_T]
    outer = [t for t in second if not (v[t][:, 0] == 1).all()]
    return v, np.concatenate([CUBE_T, outer])


def test_bad_meshes_are_refused_in_one_line(tmp_path, capsys):
    out = tmp_path / "o.ply"
    twice = np.concatenate([CUBE_V, CUBE_V + 0.4])
    for name, v, t, say in (
        ("wall", *inner_wall(), "remove double or inner faces"),
        ("strip", *moebius(), "not orientable"),
        ("crossed", twice, np.concatenate([CUBE_T, CUBE_T + 8]), "repair it, or join the bodies"),
        ("flat", CUBE_V * [1, 1, 0], CUBE_T, "encloses no volume"),
        ("open", CUBE_V, CUBE_T[2:], "--close"),
    ):
        path = tmp_path / f"{name}.off"
        write_mesh(path, v, t)
        error = refusal(capsys, path, "-o", out)
        assert say in error and f"{name}.off" in error and not out.exists()
    (tmp_path / "empty.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    assert "no face" in refusal(capsys, tmp_path / "empty.obj", "-o", out)


def test_clouds_without_a_body_are_refused_in_one_line(cloud, tmp_path, capsys):
    rng = np.random.default_rng(7)
    blob, few, flat, out = (
        tmp_path / name for name in ("blob.ply", "few.xyz", "flat.ply", "o.ply")
    )
    write_cloud(blob, rng.normal(size=(3000, 3)))
    write_cloud(few, CUBE_V[:3])
    write_cloud(
        flat, np.column_stack([rng.uniform(-2, 2, (3000, 2)), 0.01 * rng.normal(size=3000)])
    )
    error = refusal(capsys, blob, "-o", out, "--no-filter")
    assert "show no ground" in error and "--ground none" in error and "blob.ply" in error
    for words, say in (
        ((blob,), "blob.ply"),
        ((blob, "--no-filter", "--ground", "none"), "close more"),
        ((few,), "few.xyz"),
        ((few, "--no-filter"), "no point stands above the ground"),
        ((few, "--no-filter", "--ground", "none"), "no bod"),
        ((flat,), "no point stands above the ground"),
        ((flat, "--ground", "5"), "no point stands above the ground"),
        ((cloud, "--polygon", "9,9", "10,9", "10,10"), "nothing rises"),
        ((cloud, "--polygon", "0,0", "1,1"), "three"),
        ((cloud, "--polygon", "0,0", "1,1", "2,2"), "no area"),
        ((cloud, "--pick=30,0,0"), "pick on it"),
    ):
        assert say in refusal(capsys, words[0], "-o", out, *words[1:])
    assert not out.exists()


#: Repairs by body: the box takes ten times as long as the sphere.
TRIED = {"box": ("both", "remove"), "sphere": REPAIRS}


@pytest.fixture(scope="module", params=list(TRIED))
def published(request, tmp_path_factory):
    """The thesis's cloud filtered as published by the command line, and what the study makes of it:
    file, longest side, volumes by repair, repairs to try.
    """
    name = request.param
    folder = tmp_path_factory.mktemp("published")
    raw, out = folder / "raw.ply", folder / "filtered.ply"
    cloud = getattr(thesis_scene, name)(0)
    write_cloud(raw, cloud)
    words = ("--preset", name, "--set", "filter.order=published")
    assert main(["filter", str(raw), "-o", str(out), *words]) == 0
    settings = {"box": BOX, "sphere": SPHERE}[name]
    modes = thesis.repair_modes(filter_cloud(cloud, thesis.preset(name)), settings)
    volumes = {repair: mode.volume_m3 for repair, mode in modes.items()}
    return out, settings.radius_m, volumes, TRIED[name]


def test_the_published_repairs_are_those_of_the_study(published, tmp_path, capsys):
    # Tables 9.3 and 9.4 from the command line
    path, radius_m, volume_m3, tried = published
    assert len({round(v, 6) for v in volume_m3.values()}) == len(REPAIRS)
    for repair in tried:
        out = tmp_path / f"{repair}.ply"
        words = ("--no-filter", "--mesh-radius", radius_m, "--repair", repair)
        facts = answer(capsys, path, "-o", out, *words)
        assert facts["volume_m3"] == pytest.approx(volume_m3[repair], rel=1e-9) and out.exists()
        reasons = [r["name"] for r in facts["verdict"]["reasons"]]
        assert "mesh_published" in reasons
        assert set(reasons) <= {"mesh_published", "mesh_crossings", "no_sigma"}
    assert main(["body", *map(str, (path, "-o", out, *words)), "--strict", "--json"]) == 3
    capsys.readouterr()


def test_repair_says_what_it_needs(published, tmp_path, capsys):
    out = tmp_path / "o.ply"
    words = (published[0], "-o", out, "--no-filter", "--repair", "both")
    assert "--mesh-radius" in refusal(capsys, *words)
    assert "--ground none" in refusal(capsys, *words, "--mesh-radius", "0.2", "--ground", "0")


def grid_piles(spacing, size=1.0):
    """Two pyramids of 8 and 4 m on a ground of 30 x 16 m, times ``size``; exact points."""
    x, y = np.meshgrid(np.arange(0, 30, spacing), np.arange(0, 16, spacing))
    rng = np.random.default_rng(3)
    x, y = (a.ravel() + 0.2 * spacing * rng.uniform(-1, 1, a.size) for a in (x, y))
    z = np.maximum(3 - np.maximum(abs(x - 8), abs(y - 8)) * 0.75, 0)
    z = np.maximum(z, 1.5 - np.maximum(abs(x - 22), abs(y - 8)) * 0.75)
    return size * np.column_stack([x, y, np.maximum(z, 0)])


@pytest.mark.parametrize("spacing", [0.2, 0.5])
def test_objects_step_by_the_spacing(spacing):
    # 0.3 m between points of one object found nothing at 0.5 m
    p = grid_piles(spacing)
    step = step_between(p)
    found = find_objects(p, [design_surface([0.0])], ObjectParameters(distance_m=step))
    assert len(found.records) == 2
    assert step_between(1000.0 * p) == pytest.approx(1000.0 * step, rel=1e-9)


def test_points_in_no_body_are_counted_and_refused():
    p, ground = grid_piles(0.2), design_surface([0.0])
    q = ObjectParameters(distance_m=0.5, min_points=1000)
    missed = missed_points(p, ground, find_objects(p, [ground], q), q)
    assert 0.05 < missed.share < 0.5 and missed.small == 1
    with pytest.raises(ObjectError, match="are in no body"):
        check_missed(missed)


def test_clusters_that_are_all_too_small_are_refused_with_numbers():
    p, ground = grid_piles(0.2), design_surface([0.0])
    q = ObjectParameters(distance_m=0.5, min_points=10**6)
    missed = missed_points(p, ground, find_objects(p, [ground], q), q)
    with pytest.raises(ObjectError, match=f"all of the {missed.above:,} points") as error:
        check_missed(missed)
    assert "clusters too small" in str(error.value)


def test_what_the_filter_left_out_is_doubted_or_refused():
    assert filter_doubts(ExcludedPoints(1000, 40, 0.1)) == ()
    (doubt,) = filter_doubts(ExcludedPoints(1000, 400, 0.1))
    assert doubt.name == "points_left_out" and doubt.value == 0.4 and "40 %" in doubt.text
    with pytest.raises(ObjectError, match="--no-filter") as error:
        filter_doubts(ExcludedPoints(1000, 600, 0.1))
    assert error.value.reason == "object_left_out" and error.value.value == 0.6


def sparse_cone(seed=0):
    """A cone of 523.6 m³ on 40 x 40 m, one point to the square metre, 10 mm of noise, and strays
    in the air.
    """
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-20.0, 20.0, (1600, 2))
    z = np.maximum(0.0, 5.0 - 0.5 * np.hypot(*xy.T)) + 0.01 * rng.normal(size=len(xy))
    strays = rng.uniform((-20, -20, 1), (20, 20, 8), (16, 3))
    return np.concatenate([np.column_stack([xy, z]), strays])


@pytest.fixture(scope="module")
def cones(tmp_path_factory):
    """What is said of a sparse cone in millimetres, metres and kilometres."""
    folder, found = tmp_path_factory.mktemp("cones"), {}
    for size in (1e-3, 1.0, 1e3):
        path = folder / "cone.ply"
        write_cloud(path, size * sparse_cone())
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            assert main(["body", str(path), "-o", str(folder / "o.ply"), "--json"]) == 0
        found[size] = json.loads(out.getvalue())
    return found


def test_a_sparse_steep_pile_has_a_volume_with_an_honest_sigma(cones):
    # the filter leaves out two thirds of its points: they are taken as they came
    facts, truth = cones[1.0], np.pi * 100.0 * 5.0 / 3.0
    sigma = facts["sigma_m3"]
    assert facts["points"]["as_they_came"] and facts["points"]["left_out"] > 0.5
    assert facts["points"]["noise_m"] == pytest.approx(0.01, rel=0.2)
    assert abs(facts["volume_m3"] - truth) < 2.0 * sigma and sigma < 0.05 * truth
    assert facts["bodies"][0]["budget_m6"]["between"] > 0.5 * sigma**2
    assert facts["verdict"]["status"] == "sound" and len(facts["bodies"]) == 1


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_the_unit_of_length_is_of_no_matter(cones, size):
    one, other = cones[1.0], cones[size]
    # the filter looks at points chosen by a hash of their coordinates: the same to within that
    off = other["volume_m3"] / size**3 - one["volume_m3"]
    assert abs(off) < 0.5 * one["sigma_m3"] and len(other["bodies"]) == 1
    assert other["sigma_m3"] == pytest.approx(size**3 * one["sigma_m3"], rel=0.3)
    assert other["verdict"]["status"] == one["verdict"]["status"]


def test_one_failed_body_does_not_lose_the_others():
    v, _ = sphere(1500)
    sheet = np.column_stack([np.random.default_rng(1).uniform(-1, 1, (400, 2)), np.zeros(400)])
    points = np.concatenate([v, sheet + np.array([10.0, 0.0, 0.0])])
    label = np.repeat([0, 1], [len(v), 400])
    made = cloud_bodies(points, None, None, label, None)
    assert made.numbers == (0,) and [f.number for f in made.failed] == [1]
    assert made.failed[0].points == 400 and made.failed[0].middle_m[0] == pytest.approx(10, abs=0.1)
    verdict = bodies_verdict(made, points, None)
    assert [d.name for d in verdict.doubts] == ["body_failed"] and "at 9.99" in verdict.doubts[
        0
    ].text


def test_a_body_at_the_edge_of_the_data():
    p = grid_piles(0.2)
    assert touches_outline(p, p[p[:, 0] < 2], 0.3)
    assert not touches_outline(p, p[(abs(p[:, 0] - 8) < 4) & (abs(p[:, 1] - 8) < 4)], 0.3)


@pytest.mark.parametrize(
    ("value", "sigma", "shown"),
    [
        (1.23456, 0.0123, ("1.235 m³", "0.012 m³")),
        (1.23456e9, 4.56e6, ("1,234,600,000 m³", "4,600,000 m³")),
        (1.23456e-6, 2e-9, ("1.2346 cm³", "0.0020 cm³")),
        (0.0123456, 0.000099999, ("12.35 L", "0.10 L")),
    ],
)
def test_digits_follow_sigma(value, sigma, shown):
    assert quantity(value, sigma) == shown


def test_grass_beside_a_body_is_doubted_and_in_sigma(tmp_path, capsys):
    rng = np.random.default_rng(8)
    ground = np.c_[rng.uniform(-2.5, 2.5, (5000, 2)), np.zeros(5000)]
    ground = ground[np.abs(ground[:, :2]).max(axis=1) > 0.6]
    u = rng.uniform(-0.6, 0.6, (3000, 3))
    face = rng.integers(0, 3, 3000)
    u[np.arange(3000), face] = np.where(rng.random(3000) < 0.5, -0.6, 0.6)
    u[face == 2, 2] = 0.6
    box = np.c_[u[:, :2], u[:, 2] + 0.6]
    grown = ground + np.c_[np.zeros((len(ground), 2)), rng.gamma(2.0, 0.02, len(ground))]
    verdicts = []
    for low in (ground, grown):
        path = tmp_path / "cloud.npy"
        np.save(path, np.r_[low, box] + rng.normal(0.0, 0.004, (len(low) + 3000, 3)))
        verdicts.append(answer(capsys, path, "-o", tmp_path / "o.ply"))
    clean, grass = verdicts
    assert "vegetation" not in {r["name"] for r in clean["verdict"]["reasons"]}
    assert "vegetation" in {r["name"] for r in grass["verdict"]["reasons"]}
    for found in verdicts:
        assert abs(found["volume_m3"] - 1.2**3) < 3.0 * found["sigma_m3"]


def test_walls_and_strays_beside_narrow_ground_are_no_grass(tmp_path):
    number = list(KINDS).index("box")
    drawn = KINDS["box"](np.random.default_rng([1006, number, 21]))
    found = ask(drawn, tmp_path)
    assert found.status == "sound" and found.z < 3.0 and found.sigma[0] < 0.005

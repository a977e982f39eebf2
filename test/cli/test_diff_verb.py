"""``ladar_volume diff``: pits and bodies from files, registration, region, density, and every
refusal in one line.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
from closed_meshes import moebius

from benchmarks.pits import PITS, pit, rim
from ladar_volume.change.excavation import Scan
from ladar_volume.cli.diff_input import icp_doubts
from ladar_volume.cli.main import main
from ladar_volume.io.meshfiles.mesh_files import read_mesh, write_mesh
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.math.se3 import exp_so3, rotation_xyz
from ladar_volume.registration.transform import Transform

OPENING, FLOOR, DEPTH, SCANNER = PITS["overhang"]
EYE = ",".join(map(str, SCANNER))
POLYGON = [f"{x:g},{y:g}" for x, y in rim(OPENING, 0.4)]
#: A margin wider than the undercut reaches beyond the polygon.
REGION = ["--polygon", *POLYGON, "--margin", "1.5"]


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Files of the overhanging pit, exact, and its volume."""
    folder = tmp_path_factory.mktemp("scans")
    before, after, truth = pit(OPENING, FLOOR, DEPTH, 0.25, margin=2.0)
    write_cloud(folder / "a.ply", before)
    write_cloud(folder / "b.npy", after)
    return folder, before, after, truth


def answer(capsys, *words):
    assert main(["diff", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refusal(capsys, *words):
    assert main(["diff", *map(str, words)]) == 2
    text = capsys.readouterr().err
    assert text.startswith("ladar_volume: ") and text.count("\n") == 1
    return text


def test_an_overhanging_pit_from_two_files(scans, capsys):
    folder, _, _, truth = scans
    words = [folder / "a.ply", folder / "b.npy", "--pole", EYE, *REGION, "--sigma", "0.01"]
    facts = answer(capsys, *words, "--published", "-o", folder / "body.ply")
    assert facts["volume_m3"] == pytest.approx(truth, rel=2e-4) and facts["watertight"] is True
    assert facts["pole_spread_m3"] < 1e-9 * truth and facts["closed_m3"] < 1e-9
    assert (
        facts["sigma_m3"] == pytest.approx(np.sqrt(sum(facts["budget_m6"].values())))
        and 0.005 < facts["sigma_m3"] < 0.05
    )
    assert facts["size_classes"]["offset"] == pytest.approx(
        0.01 * facts["area_m2"] / facts["volume_m3"]
    )
    assert len(facts["size_rule"]) == 2 and facts["published_m3"] != pytest.approx(truth, rel=1e-3)
    body = read_mesh(folder / "body.ply")
    assert len(body.triangles) * 3 % 2 == 0
    # another pole, the scanner as it was: the same volume, another published value
    other = answer(
        capsys,
        *words[:2],
        "--pole=-7,20,30",
        "--scanner",
        EYE,
        *REGION,
        "--sigma",
        "0.01",
        "--published",
    )
    assert other["volume_m3"] == pytest.approx(facts["volume_m3"], rel=1e-12)
    assert abs(other["published_m3"] / facts["published_m3"] - 1) > 0.01
    # and as a person sees it
    assert (
        main(
            [
                "diff",
                *map(str, words),
                "--mass",
                "12600",
                "--mass-sigma",
                "60",
                "--resolution",
                "0.5",
                "0.7",
            ]
        )
        == 0
    )
    text = capsys.readouterr().out
    assert "density" in text and "any pole" in text and "100 m³" in text and "dimension" in text


def test_without_a_polygon_the_region_is_the_outline_of_a_less_its_margin(scans, capsys):
    folder, before, _, truth = scans
    facts = answer(capsys, folder / "a.ply", folder / "b.npy", "--scanner", EYE)
    assert facts["volume_m3"] == pytest.approx(truth, rel=1e-3)
    corners = np.array(facts["region"]["corners_m"])
    assert facts["region"]["margin_m"] == pytest.approx(0.7)
    assert corners.min(axis=0) == pytest.approx(before[:, :2].min(axis=0) + 0.7)
    # picked points in place of the polygon
    write_cloud(folder / "picked.csv", np.column_stack([rim(OPENING, 0.4), np.zeros(4)]))
    facts = answer(
        capsys,
        folder / "a.ply",
        folder / "b.npy",
        "--scanner",
        EYE,
        "--selection",
        folder / "picked.csv",
        "--margin",
        1.5,
    )
    assert np.array(sorted(facts["region"]["corners_m"])) == pytest.approx(
        np.array(sorted(rim(OPENING, 0.4).tolist()))
    )
    (folder / "corners.txt").write_text("".join(f"{x} {y}\n" for x, y in rim(OPENING, 0.4)))
    again = answer(
        capsys,
        folder / "a.ply",
        folder / "b.npy",
        "--scanner",
        EYE,
        "--polygon",
        folder / "corners.txt",
        "--margin",
        1.5,
    )
    assert again["volume_m3"] == pytest.approx(facts["volume_m3"], rel=1e-9)


def test_registration_from_the_verb_brings_b_home_and_enters_sigma(scans, tmp_path, capsys):
    folder, _, after, truth = scans
    R, shift = rotation_xyz(0.0, 0.0, 0.7), np.array([30.0, -4, 1.5])
    write_cloud(tmp_path / "b.ply", (after - shift) @ R)  # b in its scanner's frame
    rng, rows = np.random.default_rng(3), []
    for k, centre in enumerate([[-2.0, -2, 0.5], [5, -2, 1.5], [5, 5, 0.4], [-2, 5, 1.0]]):
        u = rng.standard_normal((40, 3))
        rows.append(
            np.column_stack([centre + 0.1 * u / np.linalg.norm(u, axis=1)[:, None], np.full(40, k)])
        )
    map_points = np.concatenate(rows)
    for name, points in (("map", map_points[:, :3]), ("scan", (map_points[:, :3] - shift) @ R)):
        noisy = points + 0.002 * rng.standard_normal(points.shape)
        write_cloud(tmp_path / f"{name}.csv", noisy, {"sphere": map_points[:, 3].astype(np.int32)})
    options = [
        "--radius",
        "0.1",
        "--noise-a",
        "0.002",
        "--noise-b",
        "0.002",
        "--levelled",
        "--json",
    ]
    assert main(["register", str(tmp_path / "scan.csv"), str(tmp_path / "map.csv"), *options]) == 0
    (tmp_path / "T.json").write_text(capsys.readouterr().out)
    eye_b = ",".join(f"{v:.9f}" for v in (np.array(SCANNER) - shift) @ R)
    words = [
        folder / "a.ply",
        tmp_path / "b.ply",
        "--scanner",
        EYE,
        f"--scanner-b={eye_b}",
        "--transform-b",
        tmp_path / "T.json",
        *REGION,
    ]
    facts = answer(capsys, *words, "--sigma", "0.002")
    assert (
        facts["budget_m6"]["registration_b"] > 0
        and abs(facts["volume_m3"] - truth) < 4 * facts["sigma_m3"] < 0.1
    )
    assert facts["size_classes"]["height"] > 0


def test_epochs_are_refined_by_the_ground_around_the_pit(tmp_path, capsys):
    """Rolling ground, the second epoch 2 cm too high and turned by 0.2°."""
    opening, floor, depth, _ = PITS["frustum"]
    before, after, _ = pit(opening, floor, depth, 0.15, margin=3.0)
    rng = np.random.default_rng(5)

    def roll(r):
        far = np.clip(np.maximum(np.abs(r[:, 0] - 2.5) - 3.0, np.abs(r[:, 1] - 2.0) - 2.5), 0, None)
        return (
            r
            + np.array([0, 0, 1.0])
            * (0.6 * far * np.sin(1.7 * r[:, 0] + 0.6 * r[:, 1]) * (r[:, 2] > -1e-9))[:, None]
        )

    before, after = (
        roll(before) + 0.003 * rng.standard_normal(before.shape),
        roll(after) + 0.003 * rng.standard_normal(after.shape),
    )
    off = (after - [2.5, 2, 0]) @ exp_so3(np.array([0.0015, -0.001, 0.0035])).T + [2.5, 2, 0.02]
    for name, r in (("a", before), ("b", after), ("off", off)):
        write_cloud(tmp_path / f"{name}.ply", r)
    words = [
        "--pole",
        "2.5,2,3",
        "--polygon",
        "-.4,-.4",
        "5.4,-.4",
        "5.4,4.4",
        "-.4,4.4",
        "--margin",
        "3",
    ]
    true, wrong, refined = (
        answer(capsys, tmp_path / "a.ply", tmp_path / name, *words, *more)
        for name, more in (("b.ply", []), ("off.ply", []), ("off.ply", ["--icp", "0.15"]))
    )
    assert abs(wrong["volume_m3"] - true["volume_m3"]) > 0.3
    sigma = refined["budget_m6"]["registration_b"] ** 0.5
    assert abs(refined["volume_m3"] - true["volume_m3"]) < 4 * sigma < 0.15
    assert abs(wrong["ring"]["mean_gap_m"]) > 0.015 > 5 * abs(refined["ring"]["mean_gap_m"])


def test_a_polygon_on_a_wall_is_cut_along_sight_lines(tmp_path, capsys):
    opening, floor, depth, scanner = PITS["frustum"]
    before, after, truth = pit(opening, floor, depth, 0.25)
    R = exp_so3(np.array([0.0, np.pi / 2 + 0.2, 0.0]))
    corners = np.concatenate([rim(opening, 0.4), np.zeros((4, 1))], axis=1) @ R.T
    write_cloud(tmp_path / "a.ply", before @ R.T)
    write_cloud(tmp_path / "b.ply", after @ R.T)
    eye = ",".join(f"{v:.9f}" for v in R @ np.array(scanner))
    words = [",".join(f"{v:.9f}" for v in c) for c in corners]
    facts = answer(
        capsys,
        tmp_path / "a.ply",
        tmp_path / "b.ply",
        f"--scanner={eye}",
        "--polygon",
        *words,
        "--margin",
        "0.5",
    )
    assert facts["volume_m3"] == pytest.approx(truth, rel=2e-4)


def test_closed_meshes_are_compared_as_bodies(tmp_path, capsys):
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array(
        [
            [0, 1, 3],
            [0, 3, 2],
            [4, 6, 7],
            [4, 7, 5],
            [0, 4, 5],
            [0, 5, 1],
            [2, 3, 7],
            [2, 7, 6],
            [0, 2, 6],
            [0, 6, 4],
            [1, 5, 7],
            [1, 7, 3],
        ]
    )
    for name, size in (("big.obj", 2.0), ("small.stl", 1.0), ("open.off", 1.0)):
        write_mesh(
            tmp_path / name, cube * size, faces[: 11 if "open" in name else 12].astype(np.int32)
        )
    facts = answer(
        capsys,
        tmp_path / "big.obj",
        tmp_path / "small.stl",
        "--pole=-3,1e1,7",
        "--mass",
        "2000",
        "--mass-sigma",
        "10",
        "--sigma",
        "0.01",
    )
    assert (
        facts["volume_m3"] == pytest.approx(7.0, rel=1e-6)
        and facts["watertight"] is True
        and facts["pole_spread_m3"] < 1e-9
    )
    assert facts["density"]["density_kg_m3"] == pytest.approx(2000 / 7) and facts["sigma_m3"] > 0
    assert answer(capsys, tmp_path / "big.obj", tmp_path / "small.stl")["sigma_m3"] is None
    assert main(["diff", str(tmp_path / "big.obj"), str(tmp_path / "small.stl")]) == 0
    assert "closed bodies" in capsys.readouterr().out
    assert "closed body" in refusal(capsys, tmp_path / "big.obj", tmp_path / "open.off")
    assert "for scans" in refusal(
        capsys, tmp_path / "big.obj", tmp_path / "small.stl", "--scanner", "0,0,0"
    )
    assert "sigma" in refusal(
        capsys, tmp_path / "big.obj", tmp_path / "small.stl", "--mass", "1", "--mass-sigma", "1"
    )
    for name, v, t, say in (
        ("flat.off", cube * [1, 1, 0], faces, "encloses no volume"),
        ("strip.off", *moebius(), "not orientable"),
        (
            "crossed.off",
            np.r_[cube, cube + np.array([0.4, 0.3, 0.2])],
            np.r_[faces, faces + 8],
            "repair it",
        ),
    ):
        write_mesh(tmp_path / name, v, t.astype(np.int32))
        error = refusal(capsys, tmp_path / "big.obj", tmp_path / name)
        assert say in error and name in error


def test_refusals(scans, tmp_path, capsys):
    folder = scans[0]
    good = [folder / "a.ply", folder / "b.npy", "--pole", EYE]
    assert "--pole" in refusal(capsys, *good[:2])
    assert "no such file" in refusal(capsys, folder / "c.ply", *good[1:])
    assert "together" in refusal(capsys, *good, "--mass", "3")
    assert "choose one" in refusal(
        capsys, *good, "--polygon", *POLYGON, "--selection", folder / "a.ply"
    )
    assert "three corners" in refusal(capsys, *good, "--polygon", "0,0", "1,1")
    assert "--polygon" in refusal(capsys, *good, "--polygon", tmp_path / "none.txt")
    assert "no point of scan A" in refusal(capsys, *good, "--polygon", "50,50", "51,50", "51,51")
    assert "margin" in refusal(capsys, *good, "--polygon", *POLYGON, "--margin", "-1")
    assert "margin" in refusal(capsys, *good, "--margin", "30")
    assert "miss surface" in refusal(
        capsys, *good, "--polygon", "-9,-9", "9,-9", "9,9", "-9,9", "--spacing", "1"
    )
    assert "no area" in refusal(capsys, *good, "--polygon", "0,0", "1,1", "2,2")
    assert "mesh file" in refusal(capsys, *good, "-o", tmp_path / "x.csv")
    assert "--icp" in refusal(capsys, *good, "--icp-cell", "1")
    assert "two different cell sizes" in refusal(capsys, *good, *REGION, "--resolution", "1")
    (tmp_path / "T.json").write_text('{"matrix": 3}')
    assert "register" in refusal(capsys, *good, "--transform", tmp_path / "T.json")
    I = np.eye(4).tolist()
    for change in (
        {"scale": 0},
        {"covariance": (-np.eye(7)).tolist()},
        {"matrix": np.diag([1, 1, -1, 1]).tolist()},
        {"pivot_m": [1, 2]},
    ):
        (tmp_path / "T.json").write_text(
            json.dumps(
                {
                    "matrix": I,
                    "scale": 1,
                    "pivot_m": [0, 0, 0],
                    "covariance": np.zeros((7, 7)).tolist(),
                }
                | change
            )
        )
        assert "T.json" in refusal(capsys, *good, "--transform", tmp_path / "T.json")
    with pytest.raises(SystemExit) as caught:
        main(["diff", *map(str, good[:2]), "--pole", "1,2"])
    assert caught.value.code == 2


def ground(rng, hollow, n=2500):
    """Points of sloping ground of 6 m, noise along the beam of a scanner above it."""
    x, y = rng.uniform(-3.0, 3.0, (2, n))
    z = 0.04 * x - 0.03 * y
    if hollow:
        z -= np.clip((1.5 - np.maximum(np.abs(x), np.abs(y))) / 0.6, 0.0, 1.0)
    r = np.column_stack([x, y, z])
    u = (r - ABOVE) / np.linalg.norm(r - ABOVE, axis=1)[:, None]
    return r + 0.003 * rng.standard_normal((n, 1)) * u


ABOVE = np.array([0.2, 0.1, 4.0])
HOLLOW = 4.0 / 3.0 * (1.5**2 + 1.5 * 0.9 + 0.9**2)
SQUARE = "--scanner 0.2,0.1,4 --polygon -2.2,-2.2 2.2,-2.2 2.2,2.2 -2.2,2.2 --margin 0.6".split()


def compared(capsys, folder, a, b, *words):
    write_cloud(folder / "a.ply", a)
    write_cloud(folder / "b.ply", b)
    code = main(["diff", str(folder / "a.ply"), str(folder / "b.ply"), *SQUARE, *words, "--json"])
    facts = json.loads(capsys.readouterr().out)
    return code, facts, {r["name"] for r in facts["verdict"]["reasons"]}


@pytest.mark.parametrize(("seed", "up"), [(0, 0.05), (1, -0.02), (2, 0.1), (3, 0.005)])
def test_a_scan_too_high_is_said_and_taken_out(tmp_path, capsys, seed, up):
    rng = np.random.default_rng(seed)
    a, b = ground(rng, False), ground(rng, True)
    off = b @ exp_so3(rng.normal(0.0, 0.1 * abs(up), 3)).T + [0.0, 0.0, up]
    code, facts, names = compared(capsys, tmp_path, a, off, "--strict")
    assert code == 3 and names == {"registration"}
    assert abs(facts["volume_m3"] - HOLLOW) < 3.0 * facts["sigma_m3"]
    assert facts["ring"]["effect_m3"] == pytest.approx(facts["volume_m3"] - HOLLOW, abs=0.06)
    text = facts["verdict"]["reasons"][0]["text"]
    assert "the ring differs by" in text and "--ring-correction" in text
    code, facts, names = compared(
        capsys, tmp_path, a, off, "--strict", "--ring-correction", "rigid"
    )
    assert code == 0 and not names and facts["ring"]["correction"] == "rigid"
    assert abs(facts["volume_m3"] - HOLLOW) < 3.0 * facts["sigma_m3"] < 0.15


@pytest.mark.parametrize(("seed", "share"), [(0, 0.005), (1, 0.02), (2, 0.05)])
def test_returns_that_stand_alone_do_not_tear_the_ring(tmp_path, capsys, seed, share):
    rng = np.random.default_rng(10 + seed)
    clouds = ground(rng, False), ground(rng, True)
    for r in clouds:
        rows = rng.choice(len(r), int(share * len(r)), replace=False)
        r[rows] = ABOVE + (r[rows] - ABOVE) * rng.uniform(0.2, 1.5, (len(rows), 1))
    _, facts, names = compared(capsys, tmp_path, *clouds)
    assert abs(facts["volume_m3"] - HOLLOW) < 3.0 * facts["sigma_m3"]
    assert ("isolated" in names) == (share > 0.02) and facts["surfaces"][0]["isolated"] > 0


def test_a_transform_of_doubt_and_a_volume_without_sigma_are_doubtful(scans, tmp_path, capsys):
    reason = {"name": "left_out", "text": "sphere 2 is 54.0 mm off", "value": 0.054}
    facts = {"matrix": np.eye(4).tolist(), "pivot_m": [0, 0, 0], "scale": 1.0,
             "covariance": np.zeros((7, 7)).tolist(),
             "verdict": {"status": "doubtful", "reasons": [reason]}}  # fmt: skip
    (tmp_path / "T.json").write_text(json.dumps(facts))
    folder = scans[0]
    words = [folder / "a.ply", folder / "b.npy", "--pole", EYE, *REGION, "--sigma", "0.01"]
    found = answer(capsys, *words, "--transform-b", tmp_path / "T.json")
    assert "left_out" in {r["name"] for r in found["verdict"]["reasons"]}
    assert "T.json" in found["verdict"]["reasons"][0]["text"]


def test_a_refinement_that_wandered_or_did_not_settle_is_doubtful():
    r = np.random.default_rng(1).uniform(-3.0, 3.0, (50, 3))
    C = np.zeros((7, 7))
    C[3:6, 3:6] = 0.002**2 * np.eye(3)
    stated = Transform(np.eye(3), np.zeros(3), np.zeros(3), 1.0, C)
    icp = {"converged": True, "rounds": 9, "reach_m": 0.15, "sigma_m": 0.004, "moved_m": 0.05}
    free, bound = Scan(r, ABOVE, 0.003), Scan(r, ABOVE, 0.003, stated)
    assert icp_doubts(icp, free) == []
    assert [d.name for d in icp_doubts(icp, bound)] == ["icp_moved"]
    assert [d.name for d in icp_doubts(icp | {"moved_m": 0.2}, free)] == ["icp_moved"]
    lost = icp_doubts(icp | {"converged": False}, free)
    assert [d.name for d in lost] == ["icp_not_converged"] and "9 steps" in lost[0].text


def test_a_surface_that_was_not_seen_and_a_part_of_the_region(tmp_path, capsys):
    rng = np.random.default_rng(5)
    a, b = ground(rng, False, 5000), ground(rng, True, 5000)
    hole = b[np.abs(b[:, :2]).max(axis=1) > 0.8]
    _, facts, names = compared(capsys, tmp_path, a, hole)
    assert "unseen" in names or abs(facts["volume_m3"] - HOLLOW) < 3.0 * facts["sigma_m3"]
    write_cloud(tmp_path / "half.ply", b[b[:, 0] < 1.0])
    text = refusal(capsys, tmp_path / "a.ply", tmp_path / "half.ply", *SQUARE)
    assert "miss surface B" in text

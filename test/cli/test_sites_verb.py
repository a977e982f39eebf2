"""``ladar_volume sites``: many surveys in one table, computed once, with their change."""

import csv
import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.site.survey_files import companions, date_in, key_of, survey_files
from ladar_volume.model.errors import InputError


def pile(height, seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-10.0, 10.0, (1500, 2))
    z = np.maximum(0.0, height * (1.0 - np.hypot(*xy.T) / 5.0)) + rng.normal(0.0, 0.01, 1500)
    return np.column_stack([xy, z])


def cone(height):
    return np.pi * 25.0 * height / 3.0


@pytest.fixture
def yards(tmp_path):
    """Two sites: one by folder with two epochs, one by name with two; and a file that is none."""
    folder = tmp_path / "yards"
    (folder / "north").mkdir(parents=True)
    for name, height, seed in (
        ("north/survey_20260501.npy", 2.0, 1),
        ("north/survey_20260601.npy", 2.5, 2),
        ("south 2026-05-02T0930.npy", 1.0, 3),
        ("south 2026-06-02T0930.npy", 1.5, 4),
    ):
        np.save(folder / name, pile(height, seed))
    return folder


def ran(capsys, folder, out, *words):
    words = ("--base", "ground", "--units", "m", "--json", *words)
    code = main(["sites", str(folder), "-o", str(out), *map(str, words)])
    said = capsys.readouterr()
    return code, json.loads(said.out) if said.out.startswith("{") else None, said.err


def test_a_table_with_the_change_of_every_site(yards, tmp_path, capsys):
    code, facts, _ = ran(capsys, yards, tmp_path / "out")
    assert code == 0 and facts["computed"] == 4 and facts["failed"] == 0
    rows = {(r["site"], r["epoch"]): r for r in facts["rows"]}
    may, june = rows["north/survey", "2026-05-01"], rows["north/survey", "2026-06-01"]
    assert may["net_m3"] == pytest.approx(cone(2.0), rel=0.02) and may["change_m3"] is None
    assert june["since"] == "2026-05-01"
    assert june["change_m3"] == pytest.approx(june["net_m3"] - may["net_m3"])
    assert june["sigma_change_m3"] == pytest.approx(np.hypot(june["sigma_m3"], may["sigma_m3"]))
    assert rows["south", "2026-06-02T09:30"]["since"] == "2026-05-02T09:30"
    table = list(csv.DictReader((tmp_path / "out" / "sites.csv").open(encoding="utf-8")))
    assert [float(r["net_m3"]) for r in table] == [r["net_m3"] for r in facts["rows"]]
    parquet = pytest.importorskip("pyarrow.parquet")
    columns = parquet.read_table(tmp_path / "out" / "sites.parquet")
    assert columns.to_pylist() == facts["rows"]


def test_a_second_run_computes_what_is_new_alone(yards, tmp_path, capsys):
    out = tmp_path / "out"
    first = ran(capsys, yards, out)[1]
    again = ran(capsys, yards, out)[1]
    assert again["computed"] == 0 and again["rows"] == first["rows"]
    # another option is another result
    other = ran(capsys, yards, out, "--sigma", 0.02)[1]
    assert other["computed"] == 4
    np.save(yards / "north" / "survey_20260601.npy", pile(3.0, 9))
    changed = ran(capsys, yards, out)[1]
    assert changed["computed"] == 1
    assert changed["rows"][1]["net_m3"] == pytest.approx(cone(3.0), rel=0.02)
    assert changed["rows"][0] == first["rows"][0]
    assert changed["rows"][1]["change_doubts"] == ""


def test_a_survey_that_fails_is_a_row_and_is_tried_again(yards, tmp_path, capsys):
    bad = yards / "east_20260501.xyz"
    bad.write_text("1 2 three\n")
    code, facts, _ = ran(capsys, yards, tmp_path / "out")
    assert code == 1 and facts["failed"] == 1
    row = facts["rows"][0]
    assert (row["site"], row["status"], row["net_m3"]) == ("east", "failed", None) and row["doubts"]
    np.savetxt(bad, pile(1.0, 5))
    code, facts, _ = ran(capsys, yards, tmp_path / "out")
    assert code == 0 and facts["computed"] == 1
    assert facts["rows"][0]["net_m3"] == pytest.approx(cone(1.0), rel=0.03)


def two_piles(west, east, seed):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-10.0, 10.0, (3000, 2)) * [2.0, 1.0]
    z = rng.normal(0.0, 0.01, 3000)
    for x, height in ((-10.0, west), (10.0, east)):
        z += np.maximum(0.0, height * (1.0 - np.hypot(xy[:, 0] - x, xy[:, 1]) / 5.0))
    return np.column_stack([xy, z])


def test_found_piles_are_followed_by_their_place_and_not_by_their_size(tmp_path, capsys):
    folder = tmp_path / "yard"
    folder.mkdir()
    np.save(folder / "a_20260501.npy", two_piles(2.0, 3.0, 1))
    np.save(folder / "a_20260601.npy", two_piles(3.0, 2.0, 2))
    code, facts, _ = ran(capsys, folder, tmp_path / "out", "--piles", "found")
    assert code == 0
    june = {r["pile"]: r for r in facts["rows"][2:]}
    # the larger one of May is the eastern one
    assert june["pile 1"]["change_m3"] == pytest.approx(-cone(1.0), rel=0.05)
    assert june["pile 2"]["change_m3"] == pytest.approx(cone(1.0), rel=0.05)


def test_no_change_is_told_where_names_do_not_tell_what_to_compare(tmp_path, capsys):
    folder = tmp_path / "yard"
    folder.mkdir()
    for name, height in (("east", 2.0), ("west", 1.0)):
        np.save(folder / f"{name}.npy", pile(height, 1))
        np.save(folder / f"pile{name}_20260501.npy", pile(height, 2))
        np.save(folder / f"pile{name}_20260601.npy", pile(height, 3))
    facts = ran(capsys, tmp_path, tmp_path / "out")[1]
    for row in facts["rows"]:
        if row["epoch"]:
            # each pile against itself
            late = row["epoch"] == "2026-06-01"
            assert (row["change_m3"] is not None) == late
            assert not late or abs(row["change_m3"]) < 4.0 * row["sigma_change_m3"]
        else:
            assert row["change_m3"] is None and "no date" in row["change_doubts"]
    (folder / "again").mkdir()
    np.save(folder / "pileeast_2026-06-01.npy", pile(5.0, 4))
    twice = [r for r in ran(capsys, tmp_path, tmp_path / "out")[1]["rows"] if r["change_doubts"]]
    assert sum("several surveys" in r["change_doubts"] for r in twice) == 2


def test_a_table_below_the_surveys_is_no_survey(yards, capsys):
    first = ran(capsys, yards, yards / "out")[1]
    again = ran(capsys, yards, yards / "out")[1]
    assert again["computed"] == 0 and again["rows"] == first["rows"]


def test_a_shapefile_is_all_its_files(yards, tmp_path):
    shape = tmp_path / "a.shp"
    for name in ("a.shp", "a.dbf"):
        (tmp_path / name).write_text("1")
    survey = survey_files(yards)[0]
    one = key_of(survey, {}, companions(shape))
    (tmp_path / "a.dbf").write_text("2")
    assert key_of(survey, {}, companions(shape)) != one


def test_a_defect_in_one_survey_is_a_row(yards, tmp_path, capsys, monkeypatch):
    from ladar_volume.cli import volume as verb

    real = verb.result_of

    def broken(task, sources, progress):
        if "20260601" in sources[0].path.name:
            raise MemoryError("too large")
        return real(task, sources, progress)

    monkeypatch.setattr(verb, "result_of", broken)
    code, facts, _ = ran(capsys, yards / "north", tmp_path / "out")
    assert code == 1 and facts["failed"] == 1
    assert "MemoryError" in facts["rows"][1]["doubts"] and facts["rows"][0]["net_m3"]


def test_workers_give_the_same_table(yards, tmp_path, capsys):
    one = ran(capsys, yards / "north", tmp_path / "one")[1]
    two = ran(capsys, yards / "north", tmp_path / "two", "--workers", 2)[1]
    assert two["rows"] == one["rows"]


def test_the_table_is_printed(yards, tmp_path, capsys):
    words = ("--base", "ground", "--units", "m")
    assert main(["sites", str(yards / "north"), "-o", str(tmp_path / "out"), *words]) == 0
    out = capsys.readouterr().out
    assert "2026-06-01" in out and "2 of 2 surveys computed" in out


def test_a_damaged_result_is_named(yards, tmp_path, capsys):
    ran(capsys, yards / "north", tmp_path / "out")
    file = next((tmp_path / "out" / "results").iterdir())
    file.write_text("{")
    code, _, err = ran(capsys, yards / "north", tmp_path / "out")
    assert code == 2 and "damaged result" in err and err.count("\n") == 1
    file.write_text("[" * 100_000)
    assert "damaged result" in ran(capsys, yards / "north", tmp_path / "out")[2]


def test_a_number_changed_at_rest_is_no_result(yards, tmp_path, capsys):
    ran(capsys, yards / "north", tmp_path / "out")
    file = next((tmp_path / "out" / "results").iterdir())
    facts = json.loads(file.read_text())
    file.write_text(json.dumps(facts | {"net_m3": facts["net_m3"] + 1.0}))
    code, _, err = ran(capsys, yards / "north", tmp_path / "out")
    assert code == 2 and "changed since" in err and err.count("\n") == 1


def test_wrong_options_are_refused_before_any_work(yards, tmp_path, capsys):
    code, _, err = ran(capsys, yards, tmp_path / "out", "--base", "toe_tin")
    assert code == 2 and "goes with --piles" in err
    code, _, err = ran(capsys, yards, tmp_path / "out", "--workers", 0)
    assert code == 2 and "--workers 0" in err
    code, _, err = ran(capsys, tmp_path / "none", tmp_path / "out")
    assert code == 2 and "no such folder" in err


@pytest.mark.parametrize(
    ("name", "date", "left"),
    [
        ("yard_2026-05-31", "2026-05-31", "yard"),
        ("20260531 yard", "2026-05-31", "yard"),
        ("yard.2026.05.31T0930.v2", "2026-05-31T09:30", "yard v2"),
        ("pit 3", "", "pit 3"),
        ("20261331", "", "20261331"),
        ("scan_123456789012", "", "scan_123456789012"),
        ("20250101_to_20260531", "2026-05-31", "20250101 to"),
    ],
)
def test_dates_in_names(name, date, left):
    assert date_in(name) == (date, left)


def test_a_folder_without_surveys_is_refused(tmp_path):
    (tmp_path / ".hidden").mkdir()
    np.save(tmp_path / ".hidden" / "a.npy", np.zeros((3, 3)))
    (tmp_path / "notes.md").write_text("")
    with pytest.raises(InputError, match="holds no survey"):
        survey_files(tmp_path)


def test_the_date_may_stand_in_the_folder(tmp_path):
    (tmp_path / "yard" / "2026-05-01").mkdir(parents=True)
    np.save(tmp_path / "yard" / "2026-05-01" / "cloud.npy", np.zeros((3, 3)))
    (found,) = survey_files(tmp_path)
    assert (found.site, found.epoch) == ("yard/cloud", "2026-05-01")

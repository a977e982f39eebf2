"""The package from Python gives the numbers of the command line, and says what is wrong."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

import ladar_volume as lv
from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import ConfigurationError, InputError


@pytest.fixture(scope="module")
def cone(tmp_path_factory, cone_points):
    path = tmp_path_factory.mktemp("cone") / "cone.ply"
    write_cloud(path, cone_points)
    return path


def printed(capsys, *words):
    capsys.readouterr()
    assert main([str(word) for word in words]) == 0
    return json.loads(capsys.readouterr().out)


def plain(facts):
    return json.loads(json_text(facts))


@pytest.mark.parametrize(
    "base, words", [(0.5, ["--level", "0.5"]), ("ground", ["--base", "ground"])]
)
def test_a_volume_is_that_of_the_command_line(cone, capsys, base, words):
    found = lv.volume(cone, base=base)
    said = printed(capsys, "volume", cone, *words, "--json")
    assert plain(found.facts) == said
    assert (found.net_m3, found.sigma_m3) == (said["net_m3"], said["sigma_m3"])
    assert f"{found.net_m3:.3f}" in found._repr_html_()


def test_points_as_an_array_count_as_those_of_a_file(cone):
    r = lv.read(cone).r
    by_file, by_array = lv.volume(cone, 0.5), lv.volume(r, 0.5)
    assert by_array.net_m3 == by_file.net_m3
    assert by_array.sigma_m3 == by_file.sigma_m3
    two = lv.volume(r, r - [0, 0, 0.25], sigma=0.01, clean="off")
    assert two.net_m3 == pytest.approx(0.25 * two.area_m2, rel=1e-9)


def test_a_filter_is_that_of_the_command_line(cone, capsys, tmp_path):
    found = lv.filter(cone, radius=0.8)
    out = tmp_path / "out.ply"
    said = printed(capsys, "filter", cone, "-o", out, "--radius", "0.8", "--json")
    mine = plain(found.facts)
    for key in ("output", "columns_lost"):
        said.pop(key), mine.pop(key)
    assert mine == said
    np.testing.assert_array_equal(lv.read(out).r, found.r_m)
    assert len(found.index) + len(found.outliers) == 4000


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda r: lv.volume(r, "gruond"), "did you mean 'ground'"),
        (lambda r: lv.volume(r, 0.0, outlin="all"), "did you mean 'outline'"),
        (lambda r: lv.filter(r, radus=1.0), "did you mean 'radius'"),
    ],
)
def test_a_wrong_word_names_the_right_one(call, words):
    with pytest.raises(ConfigurationError, match=words):
        call(np.zeros((10, 3)))


@pytest.mark.parametrize(
    "options", [{"vertices": "0.1"}, {"sigma": "0.02"}, {"max_edge": ["1"]}, {"tolerance": True}]
)
def test_text_where_a_number_belongs_is_refused(cone, options):
    (name,) = options
    with pytest.raises(ConfigurationError, match=f"{name}=.* is no number"):
        lv.volume(cone, **options)


def test_an_array_that_is_no_points_is_refused():
    with pytest.raises(InputError, match=r"\(n, 3\)"):
        lv.volume(np.zeros((5, 2)), 0.0)


def test_rooms_called_like_verbs_stay_rooms():
    from ladar_volume.replay import Replay
    from ladar_volume.volume import cutfill

    assert lv.volume.cutfill is cutfill and lv.replay.Replay is Replay
    assert callable(lv.volume) and callable(lv.replay)
    assert {"read", "volume", "filter", "replay"} <= set(dir(lv))
    with pytest.raises(AttributeError):
        _ = lv.no_such_name


def test_file_verbs_run_without_ros_and_without_locks_of_unix(cone, tmp_path):
    absent = ("fcntl", "termios", "tty", "rclpy", "rosbags", "mcap", "open3d", "pymavlink")
    absent += ("matplotlib", "zstandard", "jinja2", "starlette", "foxglove", "rasterio", "pwd")
    absent += ("grp", "resource", "ament_index_python", "pyogrio", "shapely", "dask", "pyarrow")
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({absent!r}))\n"
        "from ladar_volume.cli.main import main\n"
        f"cloud, out = {str(cone)!r}, {str(tmp_path / 'f.ply')!r}\n"
        f"laz, mesh = {str(tmp_path / 'f.copc.laz')!r}, {str(tmp_path / 'm.ply')!r}\n"
        "assert main(['filter', cloud, '-o', out, '--radius', '0.8']) == 0\n"
        "assert main(['volume', out, '--level', '0.5']) == 0\n"
        "assert main(['filter', cloud, '-o', laz, '--radius', '0.8']) == 0\n"
        "assert main(['volume', laz, '--base', 'ground']) == 0\n"
        "assert main(['volume', laz, cloud]) == 0\n"
        "assert main(['epochs', laz, cloud, '--no-figure', '-o', mesh + '.change']) == 0\n"
        "assert main(['tin', laz, '-o', mesh]) == 0\n"
        "assert main(['volume', mesh, '--level', '0.5', '-o', mesh + '.files']) == 0\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, timeout=300)


def test_an_import_loads_nothing():
    code = "import sys, ladar_volume; assert not {'numpy', 'numba', 'rclpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_volume_writes_files_for_other_programs(tmp_path):
    rng = np.random.default_rng(2)
    r = np.column_stack([rng.uniform(0.0, 5.0, (80, 2)), rng.normal(1.0, 0.01, 80)])
    found = lv.volume(r, 0.0, output=str(tmp_path / "out"), formats="landxml,csv", sigma=0.01)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "result.json",
        "surface.xml",
        "volumes.csv",
    }
    assert f"{found.net_m3!r}" in (tmp_path / "out" / "volumes.csv").read_text()
    with pytest.raises(ConfigurationError, match="-o OUT"):
        lv.volume(r, 0.0, formats="landxml", sigma=0.01)


def test_a_volume_writes_its_report_or_says_why_not(cone, tmp_path):
    found = lv.volume(cone, "ground", report=tmp_path / "cone.html")
    text = (tmp_path / "cone.html").read_text(encoding="utf-8")
    assert f"{found.net_m3:.0f}"[:3] in text and (tmp_path / "cone.json").exists()
    with pytest.raises(ConfigurationError, match="give paths"):
        lv.volume(lv.read(cone), "ground", report=tmp_path / "other.html")
    assert not (tmp_path / "other.html").exists()

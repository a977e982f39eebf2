"""Several recordings of one survey replayed as one."""

import json
import shutil
from pathlib import Path

import pytest

import ladar_volume as lv
from ladar_volume.cli.main import main
from ladar_volume.io.bags import BagReader, BagWriter
from ladar_volume.io.drivers.recording_series import RecordingSeries
from ladar_volume.model.errors import BagError

BOX = Path(__file__).parents[2] / "bags" / "box"


def part(path, wanted):
    """A recording of those messages of the bundled one for which ``wanted(message, k, count)``."""
    with BagReader(BOX) as bag, BagWriter(path) as out:
        messages = list(bag.raw())
        for k, raw in enumerate(messages):
            if wanted(raw, k, len(messages)):
                out.write_raw(raw.topic, raw.kind, raw.data, raw.t_ns)
    shutil.copy(BOX / "config.yaml", path)
    return path


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parts")
    return {
        "first": part(folder / "first", lambda raw, k, n: k < 0.4 * n),
        "last": part(folder / "last", lambda raw, k, n: k >= 0.4 * n),
        "clouds": part(folder / "clouds", lambda raw, k, n: raw.topic == "velodyne_points"),
        "poses": part(folder / "poses", lambda raw, k, n: raw.topic != "velodyne_points"),
    }


def test_parts_are_one_recording(parts):
    with BagReader(BOX) as whole:
        topics, messages, lasted = whole.topics(), list(whole.raw()), whole.duration_s
    for names in (("last", "first"), ("poses", "clouds")):
        with RecordingSeries([parts[name] for name in names]) as series:
            assert series.topics() == topics
            assert series.duration_s == pytest.approx(lasted, abs=1e-6)
            got = list(series.raw())
            assert [raw.t_ns for raw in got] == [raw.t_ns for raw in messages]
            assert {(r.t_ns, r.topic, r.data) for r in got} == {
                (r.t_ns, r.topic, r.data) for r in messages
            }
            assert series.message(got[0]).header.stamp.sec > 0


def test_the_volume_is_that_of_the_whole(parts, tmp_path, capsys):
    whole = lv.replay(BOX, duration_s=6.0)
    for names in (("last", "first"), ("clouds", "poses")):
        found = lv.replay([parts[name] for name in names], duration_s=6.0)
        assert (found.volume_m3, found.sigma_m3) == (whole.volume_m3, whole.sigma_m3)
        assert found.facts["losses"] == whole.facts["losses"]
    words = ["replay", str(parts["clouds"]), str(parts["poses"]), "--no-figure", "--json"]
    assert main([*words, "--duration", "6", "-o", str(tmp_path / "out")]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["volume_m3"] == whole.volume_m3
    assert set(facts["input"]["path"].split(" + ")) == {"clouds", "poses"}


def test_what_would_count_twice_is_refused(parts, capsys, tmp_path):
    with pytest.raises(BagError, match="these would count twice"):
        RecordingSeries([parts["first"], parts["first"]])
    with pytest.raises(BagError, match="no such recording"):
        RecordingSeries([parts["first"], tmp_path / "none"])
    assert main(["replay", str(parts["first"]), str(tmp_path / "none")]) == 2
    assert "no such recording" in capsys.readouterr().err

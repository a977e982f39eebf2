"""A recording replayed by tiles against one process: the same result, whatever the tiles, the
pieces of time and the workers, and whatever is lost on the way.
"""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.replay import Replay
from ladar_volume.tiles.tile_work import OwnProcess

pytest.importorskip("pyarrow")
from ladar_volume.tiled_replay.tiled_survey import TiledReplay, Work

BAGS = Path(__file__).parents[2] / "bags"
#: Seconds of the recording of the yard that are replayed.
SHORT = 3.0


def replayed(name, work=None, duration=float("inf"), changed=()):
    """Result as plain values, estimate, and the tiled replay. changed : ``section.key=value``."""
    with BagReader(BAGS / name) as bag:
        parameters = read_config(BAGS / name / "config.yaml", list(changed))
        replay = Replay(bag, parameters, bag.roles({}), 0.0, duration)
        tiled = None if work is None else TiledReplay(replay, work)
        estimate = replay.run() if tiled is None else tiled.run()
        return replay.result(estimate), estimate, tiled


@pytest.fixture(scope="module")
def whole():
    return replayed("leo_cut", duration=SHORT)


def same(found, whole):
    assert json.dumps(found[0], sort_keys=True) == json.dumps(whole[0], sort_keys=True)
    assert np.array_equal(found[1].tin.vertices, whole[1].tin.vertices)
    assert np.array_equal(found[1].tin.triangles, whole[1].tin.triangles)


@pytest.mark.parametrize(("tile_m", "piece_s"), [(5.0, 1.3), (50.0, 60.0)])
def test_tiles_and_pieces_give_what_one_process_gives(tmp_path, whole, tile_m, piece_s):
    found = replayed("leo_cut", Work(tile_m, tmp_path, OwnProcess(), piece_s), SHORT)
    same(found, whole)
    facts = found[2].facts
    assert (facts["count"] > 20 and facts["pieces"] == 2) or tile_m == 50.0
    assert facts["notes"] == []


def test_a_turned_mounting_is_named_by_tiles_as_well(tmp_path, whole):
    def turned(found):
        return [d["text"] for d in found[0]["verdict"]["reasons"] if d["name"] == "mounting_turned"]

    changed = ["calibration.boresight_yaw_deg=0.0"]
    one = turned(replayed("leo_cut", None, 6.0, changed))
    work = Work(12.0, tmp_path, OwnProcess(), 3.0)
    by_tiles = [turned(replayed("leo_cut", work, 6.0, changed)) for _ in range(2)]
    assert len(one) == 1 and by_tiles[0] == by_tiles[1] and not turned(whole)
    assert by_tiles[0][0].split("turned to")[1][:30] == one[0].split("turned to")[1][:30]


def test_what_is_at_rest_is_not_done_again_and_what_is_damaged_is_made_anew(tmp_path, whole):
    work = Work(8.0, tmp_path, OwnProcess(), 1.5)
    folder = Path(replayed("leo_cut", work, SHORT)[2].facts["folder"])
    patches, archives = sorted((folder / "patches").iterdir()), sorted(folder.glob("returns/*"))
    kept = {path: path.stat().st_mtime_ns for path in patches[3:]}
    patches[0].unlink()
    patches[1].write_bytes(patches[1].read_bytes()[:-900])
    archives[0].write_bytes(archives[0].read_bytes()[:-2000])
    (folder / "pieces" / "000001.json").write_text("{")
    found = replayed("leo_cut", work, SHORT)
    same(found, whole)
    assert all(path.stat().st_mtime_ns == at for path, at in kept.items())
    notes = " ".join(found[2].facts["notes"])
    assert archives[0].name in notes and patches[1].name in notes
    assert found[2].facts["at_rest"] == len(patches) - 1


def test_another_base_is_computed_from_the_same_tiles(tmp_path):
    out = []
    for level in (0.0, 0.5):
        with BagReader(BAGS / "leo_cut") as bag:
            parameters = read_config(BAGS / "leo_cut" / "config.yaml", [])
            volume = replace(parameters.volume, base="level", level_m=level)
            parameters = replace(parameters, volume=volume)
            replay = Replay(bag, parameters, bag.roles({}), 0.0, 1.0)
            tiled = TiledReplay(replay, Work(12.0, tmp_path, OwnProcess()))
            out.append((tiled.run().volume.volume_m3, tiled.facts))
    assert out[0][0] != out[1][0]
    assert out[0][1]["folder"] == out[1][1]["folder"]
    assert out[1][1]["at_rest"] == out[1][1]["count"] > 0


def test_poses_out_of_order_are_georeferenced_in_one_piece(tmp_path, monkeypatch):
    """A clock that was set back says for longer than a piece what the poses after it are worth."""
    recorded = Replay.recorded_messages

    def disordered(self, *spans):
        for t_ns, role, record in recorded(self, *spans):
            late = role == "imu" and t_ns > self.bag.start_ns + 2_000_000_000
            yield t_ns, role, replace(record, t_ns=record.t_ns - 1_500_000_000) if late else record

    monkeypatch.setattr(Replay, "recorded_messages", disordered)
    expected = replayed("leo_cut", duration=SHORT)
    found = replayed("leo_cut", Work(12.0, tmp_path, OwnProcess(), 1.0), SHORT)
    same(found, expected)
    assert found[2].facts["pieces"] == 1 and "goes back" in found[2].facts["notes"][0]


def test_what_tiles_do_not_give_is_refused(tmp_path):
    with BagReader(BAGS / "leo_cut") as bag:
        parameters = read_config(BAGS / "leo_cut" / "config.yaml", [])
        volume = replace(parameters.volume, kind="bodies")
        replay = Replay(bag, replace(parameters, volume=volume), bag.roles({}))
        with pytest.raises(ConfigurationError, match="closed bodies"):
            TiledReplay(replay, Work(50.0, tmp_path, OwnProcess()))


class Small(OwnProcess):
    memory_bytes = 1 << 28


def test_a_tile_too_large_for_a_worker_is_refused_before_it_starts(tmp_path):
    with pytest.raises(ConfigurationError, match=r"tile .* needs 0.\d GB, and a worker has 0.3 GB"):
        replayed("leo_cut", Work(50.0, tmp_path, Small()), 1.0)


def test_the_verb_on_two_processes_one_of_which_is_killed(tmp_path, capsys, monkeypatch):
    distributed = pytest.importorskip("distributed")
    bag = shutil.copytree(BAGS / "leo_cut", tmp_path / "leo_cut")
    words = ["replay", str(bag), "--json", "--no-figure", "--duration", "1.5", "-o"]
    assert main([*words, str(tmp_path / "alone")]) == 0
    alone = json.loads(capsys.readouterr().out)
    kind = distributed.LocalCluster

    def doomed(**options):
        cluster = kind(**options)

        def kill():
            process = next(iter(cluster.workers.values())).process
            if process is not None:
                process.process._process.kill()

        cluster.loop.call_later(2.0, kill)
        return cluster

    monkeypatch.setattr(distributed, "LocalCluster", doomed)
    more = ["--dask", "--workers", "2", "--tile", "6"]
    assert main([*words, str(tmp_path / "tiled"), *more]) == 0
    printed = capsys.readouterr()
    tiled = json.loads(printed.out)
    assert tiled.pop("tiles")["count"] > 10 and "dashboard http" in printed.err
    assert tiled == alone
    for name in ("mesh.ply",):
        one, other = ((tmp_path / k / name).read_bytes() for k in ("alone", "tiled"))
        assert one == other
    assert main([*words, str(tmp_path / "tiled"), "--tile", "1"]) == 2
    assert "at least 4.8 m" in capsys.readouterr().err

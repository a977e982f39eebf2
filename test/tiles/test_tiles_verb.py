"""The verb ``tiles``: in this process, on two processes, and with a worker that is killed."""

import json

import numpy as np
import pytest
from tiled_clouds import LEVEL, SIGMA, at_once, by_tiles, random, write

from ladar_volume.cli.main import main
from ladar_volume.cli.scale.workers import local_cluster
from ladar_volume.model.errors import LadarVolumeError
from ladar_volume.tiles.array_file import read_arrays, write_arrays


@pytest.fixture
def cloud(tmp_path):
    return write(tmp_path / "cloud.laz", random(4000, np.random.default_rng(4)))


def words(cloud, *more):
    return ["tiles", str(cloud), "--level", str(LEVEL), "--sigma", str(SIGMA), *more]


def test_the_verb_gives_what_one_triangulation_gives(cloud, capsys):
    plain = words(cloud, "--tile", "30", "--clean", "off", "--relevant", "all")
    assert main([*plain, "--json"]) == 0
    tiled = json.loads(capsys.readouterr().out)
    whole = at_once(cloud)[1]
    for name in ("cut_m3", "fill_m3", "net_m3", "area_m2"):
        assert tiled[name] == pytest.approx(getattr(whole, name), rel=1e-9)
    budget = tiled["budget_m6"]
    assert tiled["base"] == whole.base and set(budget) == {"noise", "unseen", "between_points"}
    assert budget["noise"] == pytest.approx(whole.budget_m6["noise"], rel=1e-9)
    assert tiled["sigma_m3"] ** 2 == pytest.approx(sum(budget.values()), rel=1e-9)
    assert main(plain) == 0
    assert "tiles of 30 m" in capsys.readouterr().out
    ground = ["tiles", str(cloud), "--base", "ground", "--sigma", str(SIGMA), "--tile", "30"]
    assert main([*ground, "--strict"]) == 3
    assert "ground was found beside the body" in " ".join(capsys.readouterr().out.split())


def test_tiles_with_next_to_nothing_in_them_are_refused(tmp_path, capsys):
    """Each of them would ask all others: minutes for 600 points, and no word."""
    rng = np.random.default_rng(1)
    far = write(tmp_path / "far.laz", rng.uniform(0.0, 2e5, (600, 2)))
    assert main(words(far, "--tile", "2")) == 2
    error = capsys.readouterr().err
    assert "hold 1.0 points each" in error and error.count("\n") == 1
    enough = float(error.split("--tile ")[1].split(" ")[0])
    assert 1e5 < enough < 2e5
    assert main(words(far, "--tile", f"{enough:.0f}", "--store", str(tmp_path / "again"))) == 0


def test_errors_are_one_line(cloud, tmp_path, capsys):
    assert main(words(cloud, "--workers", "2")) == 2
    assert main(words(cloud, "--max-edge", "0.001")) == 2
    assert "no triangle counts" in capsys.readouterr().err
    assert main(words(tmp_path / "none.laz")) == 2
    pytest.importorskip("distributed")
    assert main(words(cloud, "--dask", "tcp://127.0.0.1:1")) == 2
    assert "no scheduler answers" in capsys.readouterr().err


def test_a_damaged_store_is_one_line(cloud, capsys):
    assert main(words(cloud)) == 0
    (part,) = cloud.with_name(f"{cloud.name}.tiles").rglob("000000.arrays")
    write_arrays(part, read_arrays(part) | {"notes": np.array("[1]")})
    capsys.readouterr()
    assert main(words(cloud)) == 2
    err = capsys.readouterr().err
    assert "delete it and run again" in err and err.count("\n") == 1 and len(err) < 302


def test_two_processes_one_of_which_is_killed_give_the_same(cloud, tmp_path):
    distributed = pytest.importorskip("distributed")
    from ladar_volume.tiles.tile_work import DaskWorkers

    alone = by_tiles(cloud, tmp_path / "alone", 20.0, part=1000).volume
    kind = distributed.LocalCluster
    with (
        kind(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as cluster,
        distributed.Client(cluster) as client,
    ):

        class Hit(DaskWorkers):
            """Kills a worker's process after its third result."""

            done = 0

            def run(self, task, of):
                for found in super().run(task, of):
                    self.done += 1
                    if self.done == 3:
                        next(iter(cluster.workers.values())).process.process._process.kill()
                    yield found

        workers = Hit(client)
        found = by_tiles(cloud, tmp_path / "both", 20.0, workers=workers, part=1000)
    assert workers.done > 6 and found.volume == alone and len(found.sums) > 6


def test_workers_lost_before_all_are_up_are_started_again(monkeypatch):
    distributed = pytest.importorskip("distributed")
    tried = []

    def cluster(**words):
        tried.append(words["n_workers"])
        if len(tried) < 3 or words["n_workers"] == 7:
            raise RuntimeError("Nanny failed to start.")
        return "up"

    monkeypatch.setattr(distributed, "LocalCluster", cluster)
    assert local_cluster(2) == "up" and tried == [2, 2, 2]
    with pytest.raises(LadarVolumeError, match="workers do not start: Nanny failed to start"):
        local_cluster(7)

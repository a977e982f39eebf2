"""Files of a survey that are written by parts."""

import numpy as np
import pytest
from mcap.reader import make_reader
from volume_surfaces import cone, platform, surface_update

from ladar_volume.io import cdr, surveys
from ladar_volume.io.meshfiles.tin_files import write_columns
from ladar_volume.io.pointfiles import ply_elements
from ladar_volume.io.results import result_dict
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.volume.estimator import VolumeEstimator


@pytest.fixture(scope="module")
def survey():
    """An estimator of a cone on its ground, its estimate, its result."""
    p = Parameters.read({"filter": {"nav_bin_s": 1.0}})
    e = VolumeEstimator(p)
    e.add_platform(platform())
    e.add(surface_update(cone, noise=0.01))
    estimate = e.estimate()
    return e, estimate, result_dict(estimate, p, Losses(), None, {}, {"path": "cone"})


def topics(path):
    """How many messages each topic has, and the names in the survey's metadata."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        names = [set(r.metadata) for r in reader.iter_metadata() if r.name == surveys.RECORD]
        count = {}
        for _, channel, _ in reader.iter_messages():
            name = channel.topic.rpartition("/")[2]
            count[name] = count.get(name, 0) + 1
    return count, names


def test_a_large_survey_is_written_by_parts_and_read_as_ever(survey, tmp_path, monkeypatch):
    e, estimate, result = survey
    surveys.write_survey(tmp_path / "a.mcap", estimate, e.epoch(), result)
    monkeypatch.setattr(surveys, "MOST_ROWS", 100)
    monkeypatch.setattr(surveys, "MOST_TRIANGLES", 10)
    surveys.write_survey(tmp_path / "b.mcap", estimate, e.epoch(), result)
    (whole, known), (parts, told) = topics(tmp_path / "a.mcap"), topics(tmp_path / "b.mcap")
    assert whole["tin_vertices"] == whole["mesh"] == 1
    assert parts["tin_vertices"] == -(-len(estimate.tin.vertices) // 100) > 5
    assert "mesh" not in parts and known == [{"result"}] and told == [{"result", "mesh"}]
    a, b = (surveys.read_survey(tmp_path / name) for name in ("a.mcap", "b.mcap"))
    again = VolumeEstimator.from_updates(b.parameters, b.navigation, b.updates)
    before = VolumeEstimator.from_updates(a.parameters, a.navigation, a.updates)
    assert again.estimate().volume.budget_m6 == before.estimate().volume.budget_m6


def test_a_mesh_by_parts_is_the_same_file(tmp_path, monkeypatch):
    rng = np.random.default_rng(3)
    tin = build_tin(rng.random((500, 3)))
    some = rng.random(len(tin.triangles)) < 0.5
    for mask in (some, np.ones(len(some), bool)):
        tin.relevant[:] = mask
        sizes = []
        for rows in (1 << 18, 64):
            monkeypatch.setattr(ply_elements, "AT_ONCE", rows)
            path = tmp_path / f"{rows}.ply"
            sizes.append(write_columns(path, tin, {"sigma_z": tin.vertices[:, 2] ** 2}))
        assert sizes[0] == sizes[1] and sizes[0][1] == mask.sum()
        assert (tmp_path / "64.ply").read_bytes() == (tmp_path / f"{1 << 18}.ply").read_bytes()


def test_of_many_triangles_those_between_squares_are_shown(monkeypatch):
    rng = np.random.default_rng(4)
    tin = build_tin(rng.random((3000, 3)) * (30.0, 10.0, 1.0) + (1e5, 2e6, 0.0))
    every = cdr.shown_triangles(tin)
    assert np.array_equal(every, tin.triangles) and every.dtype == np.int64
    monkeypatch.setattr(cdr, "MOST_SHOWN", 400)
    shown = cdr.shown_triangles(tin)
    assert 50 < len(shown) < 500 and shown.dtype == np.int64
    side = np.sqrt(np.prod(np.ptp(tin.vertices[:, :2], axis=0)) / 200.0)
    square = np.floor((tin.vertices[:, :2] - tin.vertices[:, :2].min(axis=0)) / side)
    of = square[shown]
    for a, b in ((0, 1), (1, 2), (2, 0)):
        assert (of[:, a] != of[:, b]).any(axis=1).all()

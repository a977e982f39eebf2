"""Notches of a survey are told by their depth and by what they may hold."""

from __future__ import annotations

import json

import numpy as np
import pytest
from volume_surfaces import cone, piece, platform, surface_update

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import write_cloud
from ladar_volume.model.parameters import Parameters
from ladar_volume.volume.estimator import VolumeEstimator
from ladar_volume.volume.field_checks.notches import segment_distances

LOST = {  # where nothing was measured, and whether it is a notch
    "nothing": (lambda x, y: np.zeros(len(x), bool), False),
    "notch": (lambda x, y: (np.abs(y) < 1.5) & (x > 0.0), True),
    "notch on the flat": (lambda x, y: (np.abs(y - 6.5) < 1.0) & (x > 0.0), False),
    "corner": (lambda x, y: (x > 0.0) & (y > 0.0), False),
    "side": (lambda x, y: x > 2.0, False),
}


def reasons(facts):
    return {d["name"]: d for d in facts["verdict"]["reasons"]}


@pytest.mark.parametrize("base", [["--level", "0"], ["--base", "ground"]])
@pytest.mark.parametrize("name", LOST)
def test_a_notch_of_a_cloud_is_named_with_what_it_may_hold(name, base, tmp_path, capsys):
    lost, is_notch = LOST[name]
    rng = np.random.default_rng(4)
    xy = rng.uniform(-8.0, 8.0, (15_000, 2))
    xy = xy[~lost(*xy.T)]
    z = 4.0 * cone(*xy.T, radius=6.0, top=1.0) + rng.normal(0.0, 0.005, len(xy))
    write_cloud(tmp_path / "cloud.ply", np.c_[xy, z], None)
    words = [*base, "--outline", "all", "--units", "m", "--json"]
    assert main(["volume", str(tmp_path / "cloud.ply"), *words]) == 0
    found = reasons(json.loads(capsys.readouterr().out))
    assert ("notch" in found) == is_notch
    if is_notch:  # 3 m wide and 6 m long, under half the height
        assert found["notch"]["value"] == pytest.approx(33.0, rel=0.2)


def test_a_notch_of_a_survey_is_named():
    update = surface_update(cone, spacing=0.25)
    x, y = update.patches.centre[:, :2].T
    for lost, is_notch in (LOST["nothing"], ((np.abs(y) < 0.9) & (x > -1.0), True)):
        rows = np.flatnonzero(~(lost(x, y) if callable(lost) else lost))
        sections = {"base": "level", "level_m": -0.5, "outline": "all", "max_edge_m": 1.0}
        e = VolumeEstimator(Parameters.read({"filter": {"nav_bin_s": 1.0}, "volume": sections}))
        e.add_platform(platform())
        e.add(piece(update, rows))
        names = [d.name for d in e.estimate().volume.verdict.doubts]
        assert ("notch" in names) == is_notch


def test_distances_from_segments():
    a, b = np.array([[0.0, 0.0], [4.0, 0.0]]), np.array([[4.0, 0.0], [4.0, 4.0]])
    p = np.array([[2.0, 3.0], [-3.0, 4.0], [4.0, 2.0]])
    expected = [[3.0, 2.0], [5.0, 7.0], [2.0, 0.0]]
    assert segment_distances(p, a, b) == pytest.approx(np.array(expected))

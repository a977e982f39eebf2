"""The level of detection of a difference, and what thresholding does."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from epoch_surfaces import PIT, epoch, flat, moved, pit
from volume_surfaces import platform, surface_update

from ladar_volume.change.change_detection import change_map, threshold_volumes, weighted_sigma
from ladar_volume.change.epoch_change import epoch_difference
from ladar_volume.cli.epochs.surveys import survey_of
from ladar_volume.cli.main import main
from ladar_volume.io.meshfiles.mesh_files import read_mesh
from ladar_volume.io.pointfiles.ply import ply_table
from ladar_volume.io.results import result_dict
from ladar_volume.io.surveys import between_datums, write_survey
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Datum
from ladar_volume.tin.full_tin import footprint_areas
from ladar_volume.uncertainty.epoch_budget import epoch_budget
from ladar_volume.volume.estimator import VolumeEstimator

K = 1.959963984540054
QUIET = {
    "range_bias_sigma_m": 0.0,
    "boresight_sigma_deg": [0.0, 0.0, 0.0],
    "lever_laser_sigma_m": [0.0, 0.0, 0.0],
    "lever_antenna_sigma_m": [0.0, 0.0, 0.0],
    "clock_sigma_s": 0.0,
    "beam_range_sigma_m": 0.0,
    "beam_vertical_sigma_deg": 0.0,
}


def mapped(new, old, separate=()):
    d, apart = epoch_difference(new, old, separate)
    change = change_map(new, old, apart, d.volume.coverage_factor, separate)
    return (
        d,
        apart,
        change,
        threshold_volumes(
            change,
            d.volume.coverage_factor,
            lambda weight: weighted_sigma(new, old, apart, weight, separate),
        ),
    )


def noisy(update, seed):
    """The survey with its patches' parameters drawn from their covariances."""
    rng, patches = np.random.default_rng(seed), update.patches
    row = np.searchsorted(patches.key, update.points.patch)
    sd = np.sqrt(np.diagonal(patches.cross, axis1=1, axis2=2))
    return moved(
        update,
        (
            np.c_[np.ones(len(row)), update.points.local]
            * (sd * rng.standard_normal(sd.shape))[row]
        ).sum(axis=1),
    )


def test_the_map_has_the_variances_of_both_surfaces():
    u, v = surface_update(flat, spacing=0.25, noise=0.06), surface_update(flat, noise=0.03)
    new, old = epoch(u, navigation=False, budget=QUIET), epoch(v, navigation=False, budget=QUIET)
    _, apart, change, _ = mapped(new, old)
    used = change.area_m2 > 0
    assert change.area_m2.sum() == pytest.approx(
        footprint_areas(apart.tin.vertices, apart.tin.triangles[apart.tin.relevant]).sum()
    )
    assert np.isnan(change.sigma_m[~used]).all() and not change.significant[~used].any()
    assert np.nanmax(np.abs(change.sigma_shared_m)) == 0.0
    upper = (
        new.sources.points.variance[new.surface.tin.source]
        / new.sources.points.normal[new.surface.tin.source, 2] ** 2
    )
    rest = change.sigma_noise_m[used] ** 2 - upper[used]
    low, high = old.sources.points.variance.min() / 3.1, old.sources.points.variance.max() * 1.01
    assert (rest > low).all() and (
        rest < high
    ).all()  # one to three heights, which err alone or alike


def test_false_alarms_are_one_in_twenty_where_only_noise_acts():
    share, raised, predicted, whole = [], [], [], []
    for seed in range(6):
        u, v = (noisy(surface_update(flat, noise=0.05), 2 * seed + k) for k in (0, 1))
        d, _, change, kept = mapped(epoch(u, False, budget=QUIET), epoch(v, False, budget=QUIET))
        share.append(change.significant[change.area_m2 > 0].mean())
        raised.append(0.5 * (kept.raised_m3 + kept.lowered_m3))
        predicted.append(kept.unchanged_m3)
        whole.append(
            kept.unchanged_without_m3
            / (0.5 * (d.volume.cut_m3 + d.volume.fill_m3 + 2 * d.volume.folded_m3))
        )
        assert kept.net_m3 == pytest.approx(
            d.volume.volume_m3 + kept.bias_m3, abs=0.5 * d.volume.sigma_m3
        )
    assert np.mean(share) == pytest.approx(0.05, abs=0.012)
    assert np.mean(raised) == pytest.approx(np.mean(predicted), rel=0.25)
    assert np.mean(whole) == pytest.approx(
        1.0, abs=0.25
    )  # heights between the vertices are quieter than at them


def test_thin_change_is_lost_to_the_threshold_and_the_bias_says_so():
    u, v = (
        surface_update(lambda x, y: flat(x, y) + 0.004, noise=0.02),
        surface_update(flat, noise=0.02),
    )
    d, _, _, kept = mapped(epoch(u, False, budget=QUIET), epoch(v, False, budget=QUIET))
    assert kept.net_m3 == 0.0 and kept.area_m2 == 0.0
    assert kept.bias_m3 == pytest.approx(-d.volume.volume_m3, rel=1e-9)
    assert kept.bias_sigma_m3 == pytest.approx(d.volume.sigma_m3, rel=0.02) and d.significant
    deep, _, change, kept = mapped(
        epoch(surface_update(pit), False, budget=QUIET), epoch(v, False, budget=QUIET)
    )
    assert (
        kept.lowered_m3 == pytest.approx(-PIT, rel=0.02)
        and kept.raised_m3 == 0.0
        and kept.area_m2 == pytest.approx(math.pi * 16, rel=0.1)
    )
    assert kept.sigma_m3 < deep.volume.sigma_m3 and change.significant.any()


def test_weighted_sums_agree_with_the_overlay_and_do_not_depend_on_who_is_finer():
    for spacing in (0.25, 1.0):
        new, old = (
            epoch(surface_update(flat, spacing=spacing, per_patch=1)),
            epoch(surface_update(flat)),
        )
        d, apart, change, _ = mapped(new, old)
        assert apart.upper_carries == (spacing < 0.5)
        # per area: the map ends at the last whole triangle of the finer surface
        per_area = weighted_sigma(new, old, apart, change.area_m2, ()) / change.area_m2.sum()
        assert per_area == pytest.approx(d.volume.sigma_m3 / d.volume.area_m2, rel=0.01)


def test_shared_errors_cancel_in_the_map_too():
    new, old = (
        epoch(
            surface_update(flat), navigation=False, budget={"lever_laser_sigma_m": [0.0, 0.0, 0.05]}
        )
        for _ in range(2)
    )
    common, apart = mapped(new, old)[2], mapped(new, old, ("lever_laser",))[2]
    assert np.nanmax(apart.sigma_shared_m) == pytest.approx(0.05 * math.sqrt(2), rel=0.05)
    assert np.nanmax(common.sigma_shared_m) < 0.01
    # navigation, each survey's own: 2 cm up and what two ten-thousandths of a radian do
    flown = mapped(
        epoch(surface_update(flat), budget=QUIET), epoch(surface_update(flat), budget=QUIET)
    )[2]
    assert np.nanmedian(flown.sigma_shared_m) == pytest.approx(0.02 * math.sqrt(2), rel=0.05)


def survey(path, height, datum=None, seed=0):
    """A result of a synthetic survey on disk, and its estimator."""
    p = Parameters.read(
        {
            "filter": {"nav_bin_s": 1.0},
            "volume": {"base": "level", "level_m": 0.0, "outline": "all"},
        }
    )
    e = VolumeEstimator(p)
    e.add_platform(platform())
    e.add(surface_update(height, seed=seed))
    estimate = e.estimate()
    path.mkdir()
    write_survey(
        path / "result.mcap",
        estimate,
        e.epoch(),
        result_dict(estimate, p, Losses(), datum, {}, {"path": path.name}),
    )
    return e


def test_the_verb_gives_what_the_surveys_in_memory_give(tmp_path, capsys):
    old, new = survey(tmp_path / "a", flat), survey(tmp_path / "b", pit)
    words = [
        "epochs",
        str(tmp_path / "a"),
        str(tmp_path / "b"),
        "-o",
        str(tmp_path / "out"),
        "--json",
    ]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    d, _, change, kept = mapped(new.epoch(), old.epoch())
    assert facts["volume_m3"] == d.volume.volume_m3  # the surface comes back bit by bit
    assert facts["sigma_m3"] == pytest.approx(d.volume.sigma_m3, rel=1e-6) and facts["significant"]
    assert (
        facts["level_of_detection"]["lowered_m3"] == pytest.approx(kept.lowered_m3, rel=1e-6)
        and facts["frame"] == "same map frame"
    )
    assert facts == json.loads((tmp_path / "out" / "epochs.json").read_text())
    mesh = read_mesh(tmp_path / "out" / "change.ply")
    columns = ply_table(tmp_path / "out" / "change.ply").columns
    assert len(columns["z"]) == np.count_nonzero(change.area_m2 > 0) == len(mesh.vertices)
    assert np.allclose(columns["level_m"], change.level_m[change.area_m2 > 0], rtol=1e-5)
    assert (tmp_path / "out" / "change.png").stat().st_size > 10_000
    (tmp_path / "corners.txt").write_text("-5 -5\n5 -5\n5 5\n-5 5\n")
    assert (
        main(
            [
                *words[:-1],
                "--no-figure",
                "--separate",
                "all",
                "--polygon",
                str(tmp_path / "corners.txt"),
            ]
        )
        == 0
    )
    assert "significance" in capsys.readouterr().out


def test_other_datums_are_the_same_place(tmp_path, capsys):
    here = Datum(50.0, 14.0, 300.0)
    there = Datum(50.0001, 14.0002, 310.0)
    T = between_datums(there, here)
    assert T is not None and between_datums(here, here) is None
    back = between_datums(here, there)
    r = np.array([[3.0, -4.0, 5.0], [100.0, 200.0, -7.0]])
    assert np.allclose(back.apply(T.apply(r)), r, atol=1e-8)
    assert T.apply(np.zeros((1, 3)))[0] == pytest.approx([14.338, 11.124, 10.0], abs=0.02)
    survey(tmp_path / "a", flat, here)
    survey(tmp_path / "b", lambda x, y: flat(x, y) - 10.0, Datum(50.0, 14.0, 310.0))
    survey(tmp_path / "c", flat)
    assert (
        main(
            [
                "epochs",
                str(tmp_path / "a"),
                str(tmp_path / "b"),
                "-o",
                str(tmp_path / "out"),
                "--json",
                "--no-figure",
            ]
        )
        == 0
    )
    assert abs(json.loads(capsys.readouterr().out)["volume_m3"]) < 1e-3
    (tmp_path / "none.mcap").write_bytes(b"nothing")
    (tmp_path / "empty").mkdir()
    for other, text in (
        ("c", "datum"),
        ("none.mcap", "not a result"),
        ("empty", "without metadata.yaml"),
    ):
        assert (
            main(
                ["epochs", str(tmp_path / "a"), str(tmp_path / other), "-o", str(tmp_path / "out")]
            )
            == 2
        )
        shown = capsys.readouterr().err
        assert text in shown and shown.count("\n") == 1


def test_a_survey_without_its_surface_is_refused(tmp_path, capsys):
    from mcap.writer import Writer

    with (tmp_path / "result.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata(
            "ladar_volume", {"result": json.dumps({"parameters": {}, "datum": None})}
        )
        writer.finish()
    assert main(["epochs", str(tmp_path), str(tmp_path), "-o", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_survey_on_disk_keeps_every_bit_of_the_surface(tmp_path):
    e = survey(tmp_path / "a", pit, seed=3)
    kept, whole = survey_of(tmp_path / "a").epoch, e.epoch()
    assert kept.tin.vertices.tobytes() == whole.tin.vertices.tobytes() and kept.t_ns == whole.t_ns
    g = np.zeros_like(whole.tin.vertices)
    g[:, 2] = 1.0
    one, two = (epoch_budget(x, x, g, 0.3 * g).lines for x in (kept, whole))
    assert one == pytest.approx(two, rel=1e-6)
    assert kept.sources.parameters.volume == whole.sources.parameters.volume
    assert np.allclose(kept.sources.C_cal, whole.sources.C_cal, rtol=1e-9)

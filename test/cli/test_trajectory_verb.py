"""``volume --trajectory``: a recorded survey as LAZ and SBET has the sigma of its replay."""

import json
from pathlib import Path

import laspy
import numpy as np
import pyproj
import pytest

import ladar_volume as lv
from ladar_volume.cli.main import main
from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.io.config import read_config
from ladar_volume.io.drivers.packet_capture import open_recording
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.replay import Replay

BAG = Path(__file__).parents[2] / "bags" / "box"
#: Half a side of the square that counts, level above the datum and start of the week's seconds.
HALF, LEVEL, START = 3.0, 0.5, 400_000.0
UTM = pyproj.CRS.from_epsg(32633).to_3d()
CORNERS = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])


def on_map(geodetic):
    """Eastings and northings of latitudes and longitudes, heights as they are."""
    change = pyproj.Transformer.from_crs(4326, 32633, always_xy=True)
    x, y = change.transform(geodetic[:, 1], geodetic[:, 0])
    return np.column_stack([x, y, geodetic[:, 2]])


def sbet_of(states, frame, t_s):
    """Poses as SBET, with a wander angle."""
    S, D = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]]), np.diag([1, -1, -1.0])
    R = S @ matrix_from_quaternion(np.concatenate([s.q_map_body for s in states])) @ D
    geodetic = frame.to_geodetic(np.concatenate([s.p_map_body for s in states]))
    table = np.zeros((len(t_s), 17))
    table[:, 0], table[:, 3], table[:, 10] = t_s, geodetic[:, 2], 0.3
    table[:, 1:3] = np.radians(geodetic[:, :2])
    table[:, 7] = np.arctan2(R[:, 2, 1], R[:, 2, 2])
    table[:, 8] = -np.arcsin(R[:, 2, 0])
    table[:, 9] = np.arctan2(R[:, 1, 0], R[:, 0, 0]) + table[:, 10]
    return table


def las_of(r, gps_time, ring):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [1e-4] * 3, np.floor(r.min(axis=0))
    header.add_crs(UTM)
    header.add_extra_dim(laspy.ExtraBytesParams("ring", np.uint8))
    las = laspy.LasData(header)
    las.x, las.y, las.z = r.T
    las.gps_time, las.ring = gps_time, ring.astype(np.uint8)
    return las


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Folder with the box's first seconds as cloud.laz and flight.sbet, volume of the replay, and
    the options of the same volume.
    """
    folder = tmp_path_factory.mktemp("flight")
    square = (HALF * CORNERS[:, :2]).ravel().tolist()
    parameters = read_config(
        BAG / "config.yaml",
        [
            "volume.base=level",
            f"volume.level_m={LEVEL}",
            "volume.outline=polygon",
            f"volume.polygon_m={square}",
        ],
    )
    clouds, states = [], []
    with open_recording(BAG) as recording:
        replay = Replay(recording, parameters, recording.roles({}), 0.0, 12.0)
        door = replay.engine.georeferencer
        points, platform = door.take_points, door.take_platform
        door.take_points = lambda: kept(points(), clouds.extend)
        door.take_platform = lambda: kept(platform(), lambda s: s is not None and states.append(s))
        volume = replay.run().volume
        frame = LocalFrame(replay.engine.datum)
    t, r, ring = (
        np.concatenate([getattr(c, n) for c in clouds]) for n in ("t_ns", "r_map", "ring")
    )
    first = t.min()
    gps = 2300 * 604_800.0 + START + (t - first) * 1e-9
    on_grid = on_map(frame.to_geodetic(r))
    las_of(on_grid, gps - 1e9, ring).write(folder / "cloud.laz")
    las_of(on_grid[::7], gps[::7] - 1e9, ring[::7]).write(folder / "thin.laz")
    t_state = np.concatenate([s.t_ns for s in states])
    table = sbet_of(states, frame, START + (t_state - first) * 1e-9)
    table.astype("<f8").tofile(folder / "flight.sbet")
    corners = on_map(frame.to_geodetic(HALF * CORNERS + [0, 0, LEVEL]))
    options = {
        "base": float(corners[0, 2]),
        "set": ["volume.outline=polygon", f"volume.polygon_m={corners[:, :2].ravel().tolist()}"],
        "trajectory": folder / "flight.sbet",
        "budget": BAG / "config.yaml",
    }
    return folder, volume, options


def kept(value, take):
    take(value)
    return value


@pytest.fixture(scope="module")
def answer(survey):
    """Of every seventh point."""
    folder, _, options = survey
    return lv.volume(folder / "thin.laz", **options)


def test_sigma_is_that_of_the_replay(survey):
    folder, volume, options = survey
    answer = lv.volume(folder / "cloud.laz", **options)
    assert answer.net_m3 == pytest.approx(volume.volume_m3, abs=0.15)
    assert answer.sigma_m3 == pytest.approx(volume.sigma_m3, rel=0.02)
    mine, exact = answer.facts["budget_m6"], volume.budget_m6
    for name in ("position", "lever_laser", "lever_antenna", "range_bias", "boresight", "attitude"):
        assert mine[name] ** 0.5 == pytest.approx(exact[name] ** 0.5, rel=0.05), name
    for name in ("beam_range", "beam_vertical", "clock"):
        assert mine[name] ** 0.5 == pytest.approx(exact[name] ** 0.5, abs=0.003), name
    assert "calibration and navigation" in answer.sigma_holds
    flown = answer.facts["trajectory"]
    assert flown["clock"] == "adjusted standard GPS time" and flown["outside"] == 0.0
    assert 3.0 < flown["range_m"][1] < 7.0 and flown["beams"] == "column 'ring'"


def test_the_schema_holds_it(answer):
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    text = (Path(__file__).parents[2] / "docs" / "result.schema.json").read_text(encoding="utf-8")
    jsonschema.Draft202012Validator(json.loads(text)).validate(
        json.loads(json.dumps({**answer.facts, "kind": "cloud"}))
    )


def test_accuracies_of_the_poses_count(survey, answer):
    folder, _, options = survey
    rms = np.zeros((2, 10))
    rms[:, 0], rms[:, 1:4] = [START - 10, START + 100], [0.028, 0.028, 0.042]
    rms[:, 7:10] = np.array([0.02, 0.02, 0.05]) * 60
    rms.astype("<f8").tofile(folder / "smrmsg.out")
    twice = lv.volume(
        folder / "thin.laz", trajectory_accuracy=folder / "smrmsg.out", **options
    ).facts["budget_m6"]
    once = answer.facts["budget_m6"]
    assert twice["position"] == pytest.approx(4.0 * once["position"])
    assert twice["attitude"] == pytest.approx(once["attitude"], rel=1e-6)


def test_without_attitudes_it_is_doubtful_and_near(survey, answer):
    folder, _, options = survey
    table = np.fromfile(options["trajectory"], "<f8").reshape(-1, 17)
    lines = ["% GPST latitude longitude height"]
    lines += [
        f"{t:.4f} {np.degrees(a):.10f} {np.degrees(b):.10f} {h:.4f}"
        for t, a, b, h in table[::10, :4]
    ]
    (folder / "flight.pos").write_text("\n".join(lines))
    found = lv.volume(folder / "thin.laz", **options | {"trajectory": folder / "flight.pos"})
    assert any("no attitudes" in reason for reason in found.reasons)
    assert found.sigma_m3 == pytest.approx(answer.sigma_m3, rel=0.05)


def test_what_does_not_fit_is_refused(survey, tmp_path, capsys):
    folder, _, options = survey
    cloud, flight = folder / "thin.laz", options["trajectory"]
    table = np.fromfile(flight, "<f8").reshape(-1, 17)

    def refused(words, kind=InputError, first=cloud, **change):
        with pytest.raises(kind, match=words):
            lv.volume(first, **options | change)

    def other(name, change):
        moved = table.copy()
        change(moved)
        moved.astype("<f8").tofile(tmp_path / name)
        return tmp_path / name

    late = other("late.sbet", lambda t: t.__setitem__((slice(None), 0), t[:, 0] + 5000.0))
    far = other("far.sbet", lambda t: t.__setitem__((slice(None), 1), t[:, 1] + 0.01))
    part = other("part.sbet", lambda t: t.__setitem__((slice(None), 0), t[:, 0] + 5.0))
    refused("of another flight", trajectory=late)
    refused("passes .* km from the points", trajectory=far)
    refused(r"covers .* % of the points", trajectory=part)
    refused("beams 0 to 1", set=[*options["set"], "georeference.beams=8"])
    refused("ends in none of", ConfigurationError, trajectory=cloud)
    refused("for one cloud above a base", ConfigurationError, base=cloud, set=[])
    refused("leave --median out", ConfigurationError, median=0.1)
    points = lv.read(cloud)
    refused("no time", first=points.r)
    assert main(["volume", str(cloud), "--level", "1", "--undulation", "40"]) == 2
    assert "--undulation goes with --trajectory" in capsys.readouterr().err


def test_heights_above_sea_level_need_the_undulation(survey, answer, tmp_path):
    folder, _, options = survey
    las = laspy.read(folder / "thin.laz")
    las.z = las.z - 45.0
    low = las_of(las.xyz, las.gps_time, las.ring)
    low.header.add_crs(pyproj.CRS.from_user_input("EPSG:32633+5773"), keep_compatibility=False)
    low.write(tmp_path / "low.laz")
    below = options | {"base": options["base"] - 45.0}
    with pytest.raises(InputError, match="--undulation"):
        lv.volume(tmp_path / "low.laz", **below)
    found = lv.volume(tmp_path / "low.laz", **below, undulation=45.0)
    assert found.sigma_m3 == pytest.approx(answer.sigma_m3, rel=1e-3)

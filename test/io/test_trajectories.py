"""Trajectories read from SBET, smrmsg and text, and times of points on their clocks."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ladar_volume.io.trajectories.flown_path import FlownPath, attitudes
from ladar_volume.io.trajectories.point_times import on_clock, time_column
from ladar_volume.io.trajectories.pos_text import read_pos
from ladar_volume.io.trajectories.sbet import read_sbet, with_accuracy
from ladar_volume.model.errors import InputError

WEEK = 604_800.0


def sbet_table(n=50, start=400_000.0):
    t = np.zeros((n, 17))
    t[:, 0] = start + 0.005 * np.arange(n)
    t[:, 1], t[:, 2] = np.radians(50.1 + 1e-6 * np.arange(n)), np.radians(14.4)
    t[:, 3] = 300.0
    t[:, 7:11] = [0.02, -0.03, 1.2, 0.2]
    return t


def written(path, table):
    table.astype("<f8").tofile(path)
    return path


def test_sbet_gives_place_and_true_heading(tmp_path):
    flown = read_sbet(written(tmp_path / "a.sbet", sbet_table()))
    assert flown.clock == "week" and len(flown) == 50
    assert flown.place[3] == pytest.approx([50.100003, 14.4, 300.0])
    nose, left = (Rotation.from_quat(flown.attitude[0]).apply(v) for v in np.eye(3)[:2])
    # heading 1.0 clockwise from north, nose 0.03 rad down, right wing 0.02 down
    assert nose == pytest.approx(
        [np.cos(0.03) * np.sin(1.0), np.cos(0.03) * np.cos(1.0), -np.sin(0.03)]
    )
    assert left[2] == pytest.approx(np.sin(0.02) * np.cos(0.03))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[:, :16], "no whole number of rows"),
        (lambda t: np.c_[t[:, :1], np.degrees(t[:, 1:3]), t[:, 3:]], "no radians"),
        (lambda t: t[::-1], "runs back"),
        (lambda t: np.where(np.arange(17) == 3, np.nan, t), "numbers that are none"),
        (lambda t: t[:1], "fewer than 2"),
        (lambda t: t[:0], "0 bytes"),
    ],
)
def test_what_is_no_sbet_is_refused(tmp_path, change, words):
    with pytest.raises(InputError, match=words):
        read_sbet(written(tmp_path / "a.out", change(sbet_table())))
    with pytest.raises(InputError, match="cannot be read"):
        read_sbet(tmp_path / "none.sbet")


def test_accuracies_are_taken_at_the_poses(tmp_path):
    flown = read_sbet(written(tmp_path / "a.sbet", sbet_table()))
    rms = np.zeros((3, 10))
    rms[:, 0] = [399_999.5, 400_000.1, 400_001.0]
    rms[:, 1:4] = [0.01, 0.02, 0.03]
    rms[:, 7:10] = [0.5, 0.6, 3.0]
    found = with_accuracy(flown, written(tmp_path / "smrmsg.out", rms))
    assert found.position_sigma_m[7] == pytest.approx([0.02, 0.01, 0.03])  # east, north, up
    assert found.attitude_sigma_rad[7] == pytest.approx(np.radians([0.5, 0.6, 3.0]) / 60)
    rms[:, 0] += 1000.0
    with pytest.raises(InputError, match="another flight"):
        with_accuracy(flown, written(tmp_path / "late.out", rms))
    with pytest.raises(InputError, match="no standard deviations"):
        with_accuracy(flown, written(tmp_path / "minus.out", -rms))


def test_rtklib_with_dates_week_and_utc(tmp_path):
    path = tmp_path / "a.pos"
    head = "% program   : rtkpost\n%  {}  latitude(deg) longitude(deg)  height(m)   Q  ns"
    head += "   sdn(m)   sde(m)   sdu(m)\n"
    row = " 50.1 14.4 {} 1 12 0.011 0.012 0.03\n"
    stamps = ["2024/05/03 10:20:30.000", "2024/05/03 10:20:30.200"]
    lines = "".join(s + row.format(300 + k) for k, s in enumerate(stamps))
    path.write_text(head.format("GPST") + lines)
    flown = read_pos(path)
    # 3 May 2024 is day 5 of GPS week 2312
    assert flown.time_s[0] == pytest.approx(2312 * WEEK + 5 * 86_400 + 10 * 3600 + 20 * 60 + 30)
    assert flown.clock == "gps" and flown.attitude is None
    assert flown.place[1] == pytest.approx([50.1, 14.4, 301.0])
    assert flown.position_sigma_m[0] == pytest.approx([0.012, 0.011, 0.03])
    path.write_text(head.format("UTC") + lines)
    assert read_pos(path).time_s[0] - flown.time_s[0] == pytest.approx(18.0)
    weeks = "".join(f"2312 {469230 + k}.000" + row.format(300) for k in range(2))
    path.write_text(head.format("GPST") + weeks)
    assert read_pos(path).time_s == pytest.approx(flown.time_s[0] + np.arange(2))


def test_a_table_with_names(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(
        "GPSTime(s),Latitude(deg),Longitude(deg),H-Ell(m),Roll,Pitch,Heading\n"
        "400000,50,14,300,1,2,90\n400000.01,50,14,300,1,2,90\n"
    )
    flown = read_pos(path)
    want = attitudes(*(np.radians([a, a]) for a in (1.0, 2.0, 90.0)))
    assert flown.clock == "week" and flown.attitude == pytest.approx(want)
    path.write_text("400000,50,14,300\n400001,50,14,300\n")
    with pytest.raises(InputError, match="no line names its columns"):
        read_pos(path)
    path.write_text("time lat lon height\n1 50 14 x\n2 50 14 3\n")
    with pytest.raises(InputError, match="height holds what is no number"):
        read_pos(path)
    path.write_text("nothing\n")
    with pytest.raises(InputError, match="no poses"):
        read_pos(path)


def path_of(start, clock):
    time = start + np.arange(0.0, 600.0)
    return FlownPath(Path("f.sbet"), time, clock, np.zeros((600, 3)), None)


@pytest.mark.parametrize("start", [1000.0, 400_000.0, WEEK - 300.0])
@pytest.mark.parametrize("clock", ["week", "gps"])
@pytest.mark.parametrize("kind", ["week", "rolled", "gps", "adjusted"])
def test_times_of_points_come_to_the_clock_of_the_trajectory(start, clock, kind):
    flown = path_of(start + (2300 * WEEK if clock == "gps" else 0.0), clock)
    own = start + np.linspace(10.0, 590.0, 100)
    time = {
        "week": own,
        "rolled": own % WEEK if start + 10 > WEEK - 1 else own,
        "gps": own + 2300 * WEEK,
        "adjusted": own + 2300 * WEEK - 1e9,
    }[kind]
    found, _ = on_clock(time, flown)
    assert found - flown.time_s[0] == pytest.approx(own - start, abs=1e-6)


def test_a_flight_on_the_clock_of_the_next_week():
    flown = path_of(WEEK - 300.0, "week")  # runs on to WEEK + 299
    found, _ = on_clock(np.linspace(10.0, 200.0, 20), flown)
    assert found[0] == pytest.approx(WEEK + 10.0)


def test_times_that_are_none_are_refused():
    flown = path_of(1000.0, "week")
    with pytest.raises(InputError, match="another flight"):
        on_clock(np.array([5000.0, 5001.0]), flown)
    with pytest.raises(InputError, match="since 1970"):
        on_clock(np.array([1.7e9, 1.7e9 + 1]), flown)
    with pytest.raises(InputError, match="have no time"):
        time_column({"intensity": np.ones(3)})
    with pytest.raises(InputError, match="at every point"):
        time_column({"gps_time": np.zeros(3)})
    with pytest.raises(InputError, match="holds no times"):
        time_column({"gps_time": np.array([1.0, np.nan])})

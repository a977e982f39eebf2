"""Clouds: every time field and layout, and every bad one refused with its reason."""

from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.tables import NUMBERS, decode, encode
from ladar_volume.model.errors import CloudError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import GeoreferenceParameters

STAMP = 1_700_000_000_123_456_789


def message(columns, **changes):
    """A PointCloud2-like message of the columns, with anything changed."""
    table = encode(columns)
    fields = [
        Message(name=c.name, offset=c.offset, datatype=NUMBERS[c.code], count=c.count)
        for c in table.columns
    ]
    stamp = Message(sec=STAMP // 10**9, nanosec=STAMP % 10**9)
    m = Message(
        header=Message(stamp=stamp),
        height=1,
        width=table.rows,
        fields=fields,
        is_bigendian=False,
        point_step=table.row_bytes,
        row_step=table.row_bytes * table.rows,
        data=table.data.tobytes(),
    )
    for name, value in changes.items():
        setattr(m, name, value)
    return m


def columns(n=5, **more):
    rng = np.random.default_rng(1)
    xyz = {axis: rng.normal(size=n).astype(np.float32) for axis in "xyz"}
    return {
        **xyz,
        "intensity": np.ones(n, np.float32),
        "ring": np.arange(n, dtype=np.uint16),
        **more,
    }


def timed(n=5):
    return columns(n, time=np.linspace(-0.1, 0.0, n).astype(np.float32))


def read(m, **parameters):
    losses = Losses()
    return returns_from_cloud(m, GeoreferenceParameters(**parameters), losses), losses


def test_velodyne_time_counts_from_the_stamp_whatever_its_sign():
    returns, losses = read(message(timed()))
    expected = STAMP + np.rint(
        np.linspace(-0.1, 0.0, 5).astype(np.float32).astype(float) * 1e9
    ).astype(np.int64)
    np.testing.assert_array_equal(returns.t_ns, expected)
    assert not losses and returns.ring.tolist() == [0, 1, 2, 3, 4]


def test_ouster_time_counts_from_first_or_last():
    t = np.array([0, 10, 99_000_000], np.uint32)
    first, _ = read(message(columns(3, t=t)))
    last, _ = read(message(columns(3, t=t)), stamp_refers_to="last")
    assert (first.t_ns - STAMP).tolist() == [0, 10, 99_000_000]
    assert (last.t_ns - STAMP).tolist() == [-99_000_000, -98_999_990, 0]


@pytest.mark.parametrize("scale", [1.0, 1e9])
def test_absolute_timestamps_in_seconds_or_nanoseconds(scale):
    seconds = 1_700_000_000.0 + np.array([0.25, 0.5, 0.75])
    returns, _ = read(message(columns(3, timestamp=seconds * scale)))
    # a float64 of nanoseconds since 1970 resolves 256 ns, one of seconds 238 ns
    assert (returns.t_ns - 1_700_000_000_000_000_000).tolist() == pytest.approx(
        [250e6, 500e6, 750e6], abs=256
    )


def test_untimed_clouds_are_refused_unless_told_otherwise():
    with pytest.raises(CloudError, match="untimed_clouds") as caught:
        read(message(columns()))
    assert caught.value.reason == "cloud_no_time"
    returns, _ = read(message(columns()), untimed_clouds="stamp")
    assert set(returns.t_ns.tolist()) == {STAMP}


def test_one_time_for_a_whole_sweep_is_none():
    still = columns(600, time=np.full(600, 0.05, np.float32))
    with pytest.raises(CloudError, match="same time") as caught:
        read(message(still))
    assert caught.value.reason == "cloud_one_time"
    assert set(read(message(still), untimed_clouds="stamp")[0].t_ns.tolist()) == {
        STAMP + 50_000_001
    }  # 0.05 as float32
    read(
        message(columns(16, time=np.zeros(16, np.float32)))
    )  # one firing of all beams is at one time


def test_nan_rows_go_with_all_their_columns_and_are_counted():
    c = timed()
    c["y"][2] = np.nan
    c["time"][4] = np.inf
    returns, losses = read(message(c))
    assert returns.ring.tolist() == [0, 1, 3] and losses.as_dict() == {
        "point_nan": 1,
        "point_time": 1,
    }


def test_organised_clouds_with_padded_rows_read_like_flat_ones():
    flat = message(timed(6))
    step, data = flat.point_step, flat.data
    padded = b"".join(data[i * 3 * step : (i + 1) * 3 * step] + b"\xff" * 7 for i in range(2))
    organised = message(timed(6), height=2, width=3, row_step=3 * step + 7, data=padded)
    np.testing.assert_array_equal(read(organised)[0].r_laser, read(flat)[0].r_laser)


def test_big_endian_clouds_are_decoded():
    c = timed()
    table = encode(c)
    layout = np.dtype(
        {
            "names": [k.name for k in table.columns],
            "formats": [">" + k.code for k in table.columns],
            "offsets": [k.offset for k in table.columns],
            "itemsize": table.row_bytes,
        }
    )
    swapped = np.empty(table.rows, layout)
    for name, values in c.items():
        swapped[name] = values
    np.testing.assert_array_equal(
        read(message(c, is_bigendian=True, data=swapped.tobytes()))[0].r_laser,
        read(message(c))[0].r_laser,
    )


def nan_cloud():
    c = timed()
    c["x"][:] = np.nan
    return message(c)


BAD = {
    "cloud_no_xyz": lambda: message({k: v for k, v in timed().items() if k != "x"}),
    "cloud_row_step": lambda: message(timed(), row_step=3),
    "cloud_point_step": lambda: message(timed(), point_step=4),
    "cloud_empty": lambda: message(timed(), width=0),
    "cloud_all_nan": nan_cloud,
    "cloud_short": lambda: message(
        timed(), width=2**31, row_step=2**31 * message(timed()).point_step
    ),
    "cloud_fields": lambda: message(
        timed(), fields=[Message(name="x", offset=0, datatype=99, count=1)]
    ),
}


def test_a_cloud_of_more_points_than_a_sweep_has_is_refused(monkeypatch):
    monkeypatch.setattr("ladar_volume.io.cloud_messages.MOST_RETURNS", 6)
    assert len(read(message(timed(6)))[0]) == 6
    with pytest.raises(CloudError, match="7 points in one cloud") as caught:
        read(message(timed(7)))
    assert caught.value.reason == "cloud_too_many"


@pytest.mark.parametrize("reason", BAD)
def test_bad_clouds_are_refused_by_name_before_anything_is_allocated(reason):
    with pytest.raises(CloudError) as caught:
        read(BAD[reason]())
    assert caught.value.reason == reason


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 40), st.data())
def test_tables_keep_every_bit(n, data):
    written = {
        "a": data.draw(arrays(np.float64, n)),
        "b": data.draw(arrays(np.uint8, n)),
        "c": data.draw(arrays(np.float32, (n, 3))),
        "d": data.draw(arrays(np.uint32, n)),
    }
    back = decode(message(written))
    for name, values in written.items():
        assert back[name].tobytes() == values.tobytes()

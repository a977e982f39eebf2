"""Clouds as the drivers of scanners write them, byte for byte: ring, time and intensity are found
by the names of the fields, and a unit that no scanner has is refused.
"""

from fractions import Fraction
from types import SimpleNamespace as Message

import numpy as np
import pytest

from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.drivers.point_layouts import NO_RING, layout_of
from ladar_volume.io.drivers.ring_count import RingCount
from ladar_volume.model.errors import CloudError, ParameterValueError
from ladar_volume.model.losses import Losses
from ladar_volume.model.parameters import GeoreferenceParameters

S = 10**9
STAMP = 1_700_000_000 * S + 125_000_000
SWEEP_NS = 100_000_000
NUMBERS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
XYZ = (("x", 0, "f4"), ("y", 4, "f4"), ("z", 8, "f4"))
POINT4D = (*XYZ, ("intensity", 16, "f4"))
#: driver → point_step and fields as its point struct lays them out, padding included. Read from
#: velodyne (branch ros2), ouster-ros (jazzy-devel: its default point, and the sensor's own with two
#: returns), HesaiLidar_ROS_2.0 2.0.12, hesai_lidar of ROS 1, rslidar_sdk 1.5.19 (XYZIRT, XYZIRTF),
#: livox_ros_driver2 1.2.6, nebula at 606ac41.
DRIVERS = {
    "Velodyne": (22, (*XYZ, ("intensity", 12, "f4"), ("ring", 16, "u2"), ("time", 18, "f4"))),
    "Ouster": (
        48,
        (
            *POINT4D,
            ("t", 20, "u4"),
            ("reflectivity", 24, "u2"),
            ("ring", 26, "u2"),
            ("ambient", 28, "u2"),
            ("range", 32, "u4"),
        ),
    ),
    "Ouster native": (
        48,
        (
            *XYZ,
            ("t", 16, "u4"),
            ("ring", 20, "u2"),
            ("range", 24, "u4"),
            ("signal", 28, "u2"),
            ("reflectivity", 30, "u1"),
            ("near_ir", 32, "u2"),
            ("flags", 34, "u1"),
            ("window", 35, "u1"),
        ),
    ),
    "Hesai": (48, (*POINT4D, ("timestamp", 24, "f8"), ("ring", 32, "u2"))),
    "Hesai or RoboSense": (
        26,
        (*XYZ, ("intensity", 12, "f4"), ("ring", 16, "u2"), ("timestamp", 18, "f8")),
    ),
    "RoboSense": (
        27,
        (
            *XYZ,
            ("intensity", 12, "f4"),
            ("ring", 16, "u2"),
            ("timestamp", 18, "f8"),
            ("feature", 26, "u1"),
        ),
    ),
    "Livox": (
        26,
        (
            *XYZ,
            ("intensity", 12, "f4"),
            ("tag", 16, "u1"),
            ("line", 17, "u1"),
            ("timestamp", 18, "f8"),
        ),
    ),
    "Livox offsets": (
        20,
        (
            ("offset_time", 0, "u4"),
            ("x", 4, "f4"),
            ("y", 8, "f4"),
            ("z", 12, "f4"),
            ("reflectivity", 16, "u1"),
            ("tag", 17, "u1"),
            ("line", 18, "u1"),
        ),
    ),
    "Nebula": (
        32,
        (
            *XYZ,
            ("intensity", 12, "u1"),
            ("return_type", 13, "u1"),
            ("channel", 14, "u2"),
            ("azimuth", 16, "f4"),
            ("elevation", 20, "f4"),
            ("distance", 24, "f4"),
            ("time_stamp", 28, "u4"),
        ),
    ),
}


def sweep(n=2000, rings=16, seed=3):
    """A turn of a scanner: places (n, 3), rings, ns since the stamp, intensities."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, SWEEP_NS, n))
    azimuth = -2 * np.pi * t / SWEEP_NS
    place = np.column_stack([np.cos(azimuth), np.sin(azimuth), 0.1 * rng.normal(size=n)])
    return (
        (place * rng.uniform(3, 40, (n, 1))).astype(np.float32),
        rng.integers(0, rings, n),
        t,
        rng.integers(1, 200, n),
    )


def cloud(step, fields, values, order="<", height=1, padding=0):
    """A PointCloud2-like message; ``values`` by name, other fields are filled with noise."""
    n = len(values["x"])
    layout = {"names": [f[0] for f in fields], "formats": [order + f[2] for f in fields]}
    dtype = np.dtype(layout | {"offsets": [f[1] for f in fields], "itemsize": step})
    bits = np.random.default_rng(9).integers(0, 255, n * step, dtype=np.uint8)
    rows = bits.view(dtype)
    for name, v in values.items():
        rows[name] = v
    width = n // height
    lines = bits.reshape(height, width * step)
    lines = np.hstack([lines, np.full((height, padding), 255, np.uint8)])
    return Message(
        header=Message(stamp=Message(sec=STAMP // S, nanosec=STAMP % S)),
        height=height,
        width=width,
        fields=[Message(name=m, offset=o, datatype=NUMBERS[c], count=1) for m, o, c in fields],
        is_bigendian=order == ">",
        point_step=step,
        row_step=width * step + padding,
        data=lines.tobytes(),
    )


def written(driver, n=2000, **more):
    """What a driver writes of a sweep."""
    place, ring, t, intensity = sweep(n)
    step, fields = DRIVERS[driver]
    names = [f[0] for f in fields]
    times = {
        "time": t * 1e-9,
        "t": t,
        "offset_time": t,
        "time_stamp": t,
        "timestamp": (STAMP + t) * (1.0 if "Livox" in driver else 1e-9),
    }
    values = dict(zip("xyz", place.T, strict=True))
    values |= {k: v for k, v in times.items() if k in names}
    values |= {k: ring for k in ("ring", "line", "channel") if k in names}
    values["intensity" if "intensity" in names else "reflectivity"] = intensity
    return cloud(step, fields, values, **more), place, ring, t, intensity


def read(message, **parameters):
    losses = Losses()
    return returns_from_cloud(message, GeoreferenceParameters(**parameters), losses), losses


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize(
    "form", [{}, {"order": ">"}, {"height": 16, "padding": 13}], ids=["flat", "big", "rows"]
)
def test_every_drivers_cloud_is_read_whole(driver, form):
    message, place, ring, t, intensity = written(driver, **form)
    returns, losses = read(message)
    np.testing.assert_array_equal(returns.r_laser, place.astype(np.float64))
    np.testing.assert_array_equal(returns.ring, ring)
    np.testing.assert_array_equal(returns.intensity, intensity)
    # float32 of 0.1 s resolves 7 ns, float64 of seconds since 1970 238 ns, of nanoseconds 256
    assert np.abs(returns.t_ns - STAMP - t).max() <= 500 and not losses
    named = layout_of([f.name for f in message.fields]).driver
    assert named == driver.removesuffix(" native").removesuffix(" offsets")


@pytest.mark.parametrize("unit", [1, 1_000, 1_000_000, S])
def test_times_since_1970_are_read_to_the_nearest_nanosecond(unit):
    """Of what a double holds of them, exactly, by whole fractions."""
    _, _, t, _ = sweep(400)
    given = (STAMP + t) / (S / unit)
    place = dict(zip("xyz", sweep(400)[0].T, strict=True))
    fields = (*XYZ, ("timestamp", 12, "f8"))
    returns, _ = read(cloud(20, fields, place | {"timestamp": given}))
    exact = [Fraction(float(v)) * (S // unit) for v in given]
    off = [abs(Fraction(int(found)) - e) for found, e in zip(returns.t_ns, exact, strict=True)]
    assert max(off) <= Fraction(1, 2)


def changed(driver, **columns):
    """A driver's sweep with columns of another type or of other numbers, packed."""
    place, _, t, _ = sweep()
    values = dict(zip("xyz", place.T, strict=True)) | columns
    fields, step = [], 0
    for name, _, code in DRIVERS[driver][1]:
        if name == "time":
            values.setdefault(name, t * 1e-9)
        code = np.asarray(columns[name]).dtype.str[1:] if name in columns else code
        fields.append((name, step, code))
        step += np.dtype(code).itemsize
    return cloud(step, tuple(fields), values)


T = sweep()[2]
WRONG = {
    "ns as float": ("Velodyne", "time", T.astype(np.float32), "cloud_time_unit"),
    "us as float": ("Velodyne", "time", (T * 1e-3).astype(np.float32), "cloud_time_unit"),
    "us as whole numbers": ("Ouster", "t", (T // 1000).astype(np.uint32), "cloud_time_unit"),
    "ms as whole numbers": ("Ouster", "t", (T // 10**6).astype(np.uint32), "cloud_time_unit"),
    "epoch in float32": ("Hesai", "timestamp", (1.7e9 + T).astype(np.float32), "cloud_time_unit"),
    "offsets as times": ("RoboSense", "timestamp", T * 1e-9, "cloud_time_epoch"),
    "ns offsets as times": ("Livox", "timestamp", T * 1.0, "cloud_time_epoch"),
    "clock since boot": ("Hesai", "timestamp", 5000.0 + T * 1e-9, "cloud_time_epoch"),
    "nothing finite": ("Hesai", "timestamp", np.full(2000, np.nan), "cloud_time_epoch"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_unit_that_no_scanner_has_is_refused_with_its_number(case):
    driver, field, values, reason = WRONG[case]
    with pytest.raises(CloudError, match=field) as caught:
        read(changed(driver, **{field: values}))
    assert caught.value.reason == reason and driver in str(caught.value)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_times_since_1970_in_any_unit(unit):
    values = (STAMP // S) * unit + (T + 125_000_000) * 1e-9 * unit
    returns, _ = read(changed("Hesai", timestamp=values))
    assert np.abs(returns.t_ns - STAMP - T).max() <= 500


def test_absolute_times_in_the_velodyne_field_and_a_simulated_clock():
    returns, _ = read(changed("Velodyne", time=(STAMP + T) * 1e-9))
    assert np.abs(returns.t_ns - STAMP - T).max() <= 500
    message = changed("Hesai", timestamp=12.5 + T * 1e-9)
    message.header.stamp = Message(sec=12, nanosec=500_000_000)
    np.testing.assert_allclose(read(message)[0].t_ns - 12_500_000_000, T, atol=1)


def test_returns_without_an_echo_are_dropped_and_counted():
    message, place, *_ = written("RoboSense")
    rows = np.frombuffer(message.data, np.uint8).reshape(-1, message.point_step).copy()
    rows[::3, :4] = np.frombuffer(np.float32(np.nan).tobytes(), np.uint8)
    message.data = rows.tobytes()
    returns, losses = read(message)
    assert losses.as_dict() == {"point_nan": len(place[::3])}
    assert len(returns) == len(place) - len(place[::3])


@pytest.mark.parametrize("values", [-1, 70_000, 2.5, np.nan, np.inf, -np.inf])
def test_what_is_no_ring_does_not_wrap_into_one(values):
    ring = np.full(2000, 3.0, np.float64)
    ring[7] = values
    returns, _ = read(changed("Velodyne", ring=ring))
    assert returns.ring[7] == NO_RING and (np.delete(returns.ring, 7) == 3).all()
    if values in (-1, 70_000):
        whole = ring.astype(np.int32)
        assert read(changed("Velodyne", ring=whole))[0].ring[7] == NO_RING


def test_fields_that_are_not_read_may_be_anything():
    message, place, *_ = written("Velodyne")
    message.fields += [
        Message(name="_", offset=0, datatype=2, count=3),
        Message(name="_", offset=0, datatype=77, count=1),
        Message(name="normal", offset=20, datatype=8, count=9),
    ]
    assert len(read(message)[0]) == len(place)
    message.fields[0].offset = -4
    with pytest.raises(CloudError) as caught:
        read(message)
    assert caught.value.reason == "cloud_point_step"


def test_more_rings_than_beams_are_a_wrong_configuration_and_single_ones_are_not():
    returns, _ = read(written("Velodyne")[0])
    RingCount(16).add(returns)
    with pytest.raises(ParameterValueError, match=r"rings up to 15 .*beams is 8: 5\d %.* 16$"):
        RingCount(8).add(returns)
    returns.ring[:5] = 900
    RingCount(16).add(returns)

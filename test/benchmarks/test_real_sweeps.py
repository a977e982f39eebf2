"""The yardsticks of the benchmarks on real and simulated sweeps: the check across rings, the scene
of rays, and the decoding of packets.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.plane_check import Cloud, Yardstick, check, rings_by_elevation, third_ring
from benchmarks.scanner_scene import BUSH, SURFACE, Case, scan, to_surface
from benchmarks.velodyne_packets import VLP16_DEG, pcap_packets, scan_packets, sweeps

DATA = Path(__file__).parents[1] / "data"


def wall(noise_m: float, rng: np.random.Generator) -> Cloud:
    """A wall 4 m ahead seen by 16 rings, noise along the beams."""
    turn, rise = (
        x.ravel() for x in np.meshgrid(np.linspace(-0.5, 0.5, 300), np.arange(-15, 16, 2))
    )
    rise = np.radians(rise)
    ray = np.column_stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    r = ray * (4.0 / ray[:, :1] + noise_m * rng.normal(size=(len(ray), 1)))
    return Cloud("wall", r, rings_by_elevation(r), Yardstick())


def test_a_wall_is_confirmed_with_the_noise_across_it() -> None:
    found = check(wall(0.01, np.random.default_rng(1)), 200)
    assert found.confirmed.mean() > 0.99
    across = 0.01 * np.sqrt(np.mean(1 / (1 + np.tan(np.linspace(-0.5, 0.5, 300)) ** 2)))
    assert np.sqrt(np.nanmean(found.rms_m**2)) == pytest.approx(across, rel=0.08)


def test_one_ring_or_two_confirm_nothing() -> None:
    cloud = wall(0.01, np.random.default_rng(1))
    for count in (1, 2):
        use = cloud.ring < count
        few = Cloud("few", cloud.r[use], cloud.ring[use], Yardstick(beyond=0.0))
        assert not check(few, 100).confirmed.any()


def test_points_anywhere_are_not_confirmed() -> None:
    r = np.random.default_rng(2).uniform(-3, 3, (30_000, 3))
    cloud = Cloud("cloud", r, np.arange(len(r)) % 16, Yardstick(beyond=0.0))
    assert check(cloud, 100).confirmed.mean() < 0.02


def test_the_third_ring_is_the_third_nearest() -> None:
    r = np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 3], [0, 0, 7]])
    assert third_ring(r, np.arange(4), np.array([0, 2])).tolist() == [3.0, 3.0]


@pytest.mark.parametrize("motion", ["standing", "rolling", "flying"])
def test_rays_without_noise_end_on_the_surfaces(motion: str) -> None:
    made = scan(Case(16, motion, 0.0, 0.0, 1e-9), 5)
    assert made.distance[made.label == SURFACE].max() < 1e-6
    if motion != "flying":  # which may pass the bush by
        assert made.distance[made.label == BUSH].max() > 0.3
    assert np.array_equal(made.distance, to_surface(made.scene, made.r))
    assert made.far.sum() > 0.2 * 0.01 * len(made.r)


def test_copies_rounding_and_seeds() -> None:
    one, two = (scan(Case(32, "standing", 0.01, 0.0, 0.01, copies), 3) for copies in (1, 2))
    assert len(two.r) == 2 * len(one.r)
    assert np.allclose(one.r, np.round(one.r, 2), atol=1e-9)
    assert len(np.unique(two.r, axis=0)) == len(np.unique(one.r, axis=0))
    assert np.array_equal(one.r, scan(Case(32, "standing", 0.01, 0.0, 0.01), 3).r)


def test_packets_of_a_vlp16_lie_on_its_rings() -> None:
    turns = sweeps(pcap_packets(DATA / "vlp16_gps.pcap"), "VLP-16")
    assert len(turns) == 4 and sum(len(t.r) for t in turns) == 73_486
    r, ring = turns[0].r, turns[0].ring
    rise = np.radians(np.sort(VLP16_DEG)[ring])
    height = r[:, 2] + 0.0112 / 15 * np.degrees(rise)
    assert np.allclose(np.arctan2(height, np.hypot(r[:, 0], r[:, 1])), rise, atol=1e-9)
    length = np.hypot(np.hypot(r[:, 0], r[:, 1]), height) / 0.002
    assert np.allclose(length, np.round(length), atol=1e-6)


def test_packets_in_a_message() -> None:
    payloads = [bytes([k]) * 1206 for k in (1, 2, 3)]
    frame = b"velodyne\0"
    body = bytes(8) + len(frame).to_bytes(4, "little") + frame
    body += bytes(-len(body) % 4) + len(payloads).to_bytes(4, "little")
    for payload in payloads:
        body += bytes(-len(body) % 4) + bytes(8) + payload
    assert scan_packets(b"\0\1\0\0" + body) == payloads

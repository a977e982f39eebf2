"""Two pieces of work at a time."""

from __future__ import annotations

import threading

import pytest

from ladar_volume.math.run_concurrently import run_concurrently
from ladar_volume.model.errors import VolumeError


def test_both_run_at_the_same_time():
    met = threading.Barrier(2, timeout=30.0)
    assert run_concurrently(lambda: (met.wait(), 1)[1], lambda: (met.wait(), 2)[1]) == (1, 2)


def test_what_either_raises_is_raised_when_both_have_ended():
    ended = threading.Event()

    def late() -> None:
        ended.wait(0.05)
        ended.set()

    def refuse() -> None:
        raise VolumeError("no", reason="volume_no_estimate")

    with pytest.raises(VolumeError):
        run_concurrently(refuse, late)
    assert ended.is_set()
    with pytest.raises(VolumeError):
        run_concurrently(lambda: None, refuse)

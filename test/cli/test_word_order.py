"""Options may stand before, between and after the names of files."""

from __future__ import annotations

import itertools

import pytest

from ladar_volume.cli.main import make_parser

ORDERS = sorted(set(itertools.permutations(["A", "B", "--json", "--level=3"])))


@pytest.mark.parametrize("words", [w for w in ORDERS if w.index("A") < w.index("B")])
def test_two_clouds_and_options_in_any_order(words: tuple[str, ...]) -> None:
    found = make_parser("volume").parse_args(["volume", *words])
    assert (str(found.cloud), str(found.cloud_b), found.json, found.level) == ("A", "B", True, 3.0)


def test_what_is_too_much_or_missing_is_still_named(capsys: pytest.CaptureFixture[str]) -> None:
    for words, named in (
        (["A", "--json", "B", "C"], "unrecognized arguments: C"),
        (["--json"], "the following arguments are required: cloud"),
        (["A", "--jsn", "B"], "did you mean --json?"),
    ):
        with pytest.raises(SystemExit) as end:
            make_parser("volume").parse_args(["volume", *words])
        assert end.value.code == 2
        assert named in capsys.readouterr().err


def test_words_for_ros_stay_together() -> None:
    found = make_parser("up").parse_args(["up", "--ros-args", "-r", "__ns:=/a", "--json"])
    assert found.ros_args == ["-r", "__ns:=/a", "--json"]

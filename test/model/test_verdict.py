"""The verdict: sound without doubts, each doubt once, plain values for the JSON."""

from argparse import ArgumentParser

from ladar_volume.cli.arguments.strict import DOUBTFUL, add_strict_option
from ladar_volume.cli.verdict_lines import exit_code
from ladar_volume.model.verdict import Doubt, Verdict

HOLE = Doubt("unseen", "3 % of the outline was not seen: fly a pass over (3, 4)", 0.03)
BASE = Doubt("base", "13 % of the points support the base: give an outline", 0.13)


def test_no_doubt_is_sound_and_any_doubt_is_not():
    assert Verdict().sound and Verdict().as_dict() == {"status": "sound", "reasons": []}
    assert not Verdict((HOLE,)).sound
    assert Verdict((HOLE,)).as_dict()["reasons"] == [
        {"name": "unseen", "text": HOLE.text, "value": 0.03}
    ]


def test_verdicts_add_up_with_each_doubt_once():
    assert (Verdict((HOLE,)) + Verdict((BASE, HOLE))).doubts == (HOLE, BASE)


def test_strict_turns_doubt_into_an_exit_code():
    parser = ArgumentParser()
    add_strict_option(parser)
    strict, lax = parser.parse_args(["--strict"]), parser.parse_args([])
    doubtful, sound = Verdict((HOLE,)).as_dict(), Verdict().as_dict()
    assert exit_code(strict, doubtful) == DOUBTFUL and exit_code(lax, doubtful) == 0
    assert exit_code(strict, sound) == 0

"""Troubles in a cloud are named, and a clean one is believed: sparse ones of the study."""

import pytest

from benchmarks.troubled_clouds import answer


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("cut", {"cut", "ground_one_sided", "outline_open"}),
        ("second pile", {"further_bodies"}),
        ("wall", {"wall", "outline_open"}),
        ("pad", {"below_base", "base_toe"}),
        ("hollow", {"base_bends"}),
        ("grass on one side", {"vegetation"}),
        ("machine", {"wall"}),
        ("machine on lines", {"wall"}),
        ("pair: part", {"cut"}),
        ("pair: higher", {"offset"}),
        ("pair: machine", {"wall"}),
    ],
)
def test_what_is_wrong_is_named(kind, names):
    found = answer(kind, 301, 6.0)
    assert found.status == "doubtful" and names & set(found.reasons)


def test_what_lies_below_the_base_is_in_sigma():
    found = answer("pad", 301, 6.0)
    assert "below_base" in found.reasons and not found.far


@pytest.mark.parametrize(("kind", "seed"), [("pair: part", 801), ("pair: cut", 804)])
def test_what_may_have_changed_beyond_the_edge_of_a_cloud_is_in_sigma(kind, seed):
    found = answer(kind, seed, 6.0)
    assert "cut" in found.reasons and found.error < -0.02 and not found.far


@pytest.mark.parametrize(("kind", "seed"), [("clean", 301), ("clean", 302), ("pair: clean", 301)])
def test_a_clean_cloud_is_believed(kind, seed):
    found = answer(kind, seed, 6.0)
    assert found.status == "sound" and not found.far and found.sigma < 0.02

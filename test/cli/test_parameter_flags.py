"""An option that names a parameter takes type, range, unit and help from its declaration."""

import argparse

import pytest

from ladar_volume.cli.arguments.parameter_flags import (
    DECLARED as CLASSES,
)
from ladar_volume.cli.arguments.parameter_flags import (
    add_parameter,
    help_of,
    spec_of,
    value_parser,
)
from ladar_volume.cli.inputs.base_choice import OWN_OPTION
from ladar_volume.cli.main import main, make_parser
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameter import specs

UNITS = ("m", "m2", "m3", "s", "hz", "deg")
#: Options with the word of a parameter that name something else.
OTHER_THINGS = {
    "replay --duration": "seconds of the recording",
    "calibrate strips --duration": "seconds of the recording",
    "tin --vertices": "a ratio of vertices as surface.ratio, or a number of them",
    "volume --vertices": "a ratio of vertices as surface.ratio, or a number of them",
    "sites --vertices": "a ratio of vertices as surface.ratio, or a number of them",
    "volume --method": "of the volume",
    "study wild --kind": "of trouble",
    "replay --start": "seconds into the recording",
    "calibrate strips --start": "seconds into the recording",
    "plan --seed": "seed of the sampled returns",
    "plan --height": "height of the flight",
    "plan --imu": "an IMU by name",
    "register --radius": "radius of the reference spheres",
    "diff --max-edge": "edge of a triangle about a scanner, which may be infinite",
    "diff --polygon": "corners of the region, in plan or on a wall",
    "epochs --polygon": "corners within which surveys are compared",
    "body --polygon": "outline of one body",
    "body --seed": "seed of the filter and of the search of the ground alike",
}

#: Options that set a parameter under another word, and why they are not made from it.
ANOTHER_WORD = {
    "--exchange-last": ("surface", "readjust", "a switch for the contrary, as published"),
    "--outage": ("survey", "outages_s", "a span FROM:TO, repeatable; no number of its own"),
    "--float": ("survey", "float_spans_s", "a span FROM:TO, repeatable; no number of its own"),
    "--pole": ("bodies", "pole_map", "a place of the map, which no range bounds"),
    "--returns": ("strips", None, "how much of a recording is read; no parameter of the method"),
}


def words():
    """Every key of every section, with and without its unit."""
    for section, cls in CLASSES.items():
        for spec in specs(cls):
            stem, _, unit = spec.key.rpartition("_")
            yield spec.key, f"{section}.{spec.key}"
            if unit in UNITS and stem:
                yield stem, f"{section}.{spec.key}"


WORDS = dict(words())


def options(parser, verb=""):
    """Verb and action of every option of the parser and its verbs and modes."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, child in action.choices.items():
                yield from options(child, f"{verb} {name}".strip())
        elif action.option_strings:
            yield f"{verb} {action.option_strings[-1]}", action


def by_hand(parser):
    """Options with the word of a parameter that are not declared from it."""
    for name, action in options(parser):
        word = name.rpartition("--")[2].replace("-", "_")
        if word in WORDS and not hasattr(action, "parameter"):
            yield name


OPTIONS = dict(options(make_parser(None)))
DERIVED = {name: action for name, action in OPTIONS.items() if hasattr(action, "parameter")}


@pytest.mark.parametrize("option", ANOTHER_WORD)
def test_an_option_under_another_word_sets_a_parameter_that_there_is(option):
    section, key, why = ANOTHER_WORD[option]
    found = [a for name, a in OPTIONS.items() if name.endswith(f" {option}")]
    assert found and why and not any(hasattr(a, "parameter") for a in found)
    assert key is None or key in CLASSES[section].__dataclass_fields__


def test_no_option_repeats_a_parameter_by_hand():
    assert set(by_hand(make_parser(None))) <= set(OTHER_THINGS) <= set(OPTIONS)


def test_an_option_that_repeats_a_parameter_is_found():
    parser = argparse.ArgumentParser()
    parser.add_argument("--level", type=float, help="above this height")
    add_parameter(parser, "--max-edge", "volume.max_edge_m")
    assert list(by_hand(parser)) == [" --level"]


def test_what_set_refuses_has_an_option_of_its_own():
    declared = {a.parameter: n.split()[-1] for n, a in DERIVED.items() if n.startswith("volume ")}
    # --vertices takes a ratio as the parameter does, or a number of vertices
    own = {f"volume.{key}": option for key, option in OWN_OPTION.items()}
    assert own.pop("volume.vertex_ratio") == "--vertices"
    assert own.items() <= declared.items()


@pytest.mark.parametrize("name", DERIVED)
def test_type_range_and_help_are_those_of_the_parameter(name):
    action = DERIVED[name]
    spec = spec_of(action.parameter)
    assert action.help.startswith(spec.help.rstrip(".").replace("%", "%%"))
    assert action.nargs == spec.vector
    if spec.choices is not None:
        assert set(spec.choices) & set(action.choices) and action.type is None
        return
    for bound, beyond in ((spec.low, -1), (spec.high, 1)):
        if bound is not None:
            assert action.type(str(bound)) == bound
            with pytest.raises(argparse.ArgumentTypeError, match="out of range"):
                action.type(str(bound + beyond * max(1, abs(bound))))
            assert f"{bound:g}" in action.help
    assert spec.unit in action.help


def test_a_value_out_of_range_is_refused_in_one_line(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["volume", "absent.ply", "--level", "20000"])
    said = capsys.readouterr().err
    assert "volume.level_m: 20000 m is out of range (allowed: -10000 to 10000 m)" in said
    assert said.count("\n") == 1


def test_a_plane_in_projected_coordinates_is_in_range():
    # z = c0 + 0.1 y at a northing of 5.5e6 m
    assert value_parser("volume.plane")("-550000") == -550000.0


def test_a_name_that_no_parameter_has_is_refused():
    for name in ("volume.levle_m", "volum.level_m", "level_m"):
        with pytest.raises(ConfigurationError, match="no parameter is called"):
            help_of(name)

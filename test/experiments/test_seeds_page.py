"""docs/seeds.md names what exists: verbs, flags, parameters, modules, names and pages."""

import argparse
import ast

import pytest

from ladar_volume.cli.main import MODULES, make_parser
from ladar_volume.model.cloud_filter_parameters import PublishedFilterParameters
from ladar_volume.model.parameter import specs
from ladar_volume.model.parameters import Parameters
from test.scenes.seeds_page import DOORS, PAGE, ROOT, ROWS

KEYS = {
    **{name: type(value) for name, value in vars(Parameters()).items()},
    "filter": PublishedFilterParameters,
}


def flags(words):
    """Options of a verb and its modes, by the real parser."""
    parser = make_parser(words[0])
    for word in words:
        (choice,) = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        assert word in choice.choices, f"no verb or mode {word}"
        parser = choice.choices[word]
    return {option for action in parser._actions for option in action.option_strings}


def names(path):
    """What a module defines at its top level."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            if isinstance(target, ast.Name):
                yield target.id


def test_the_page_has_the_four_seeds_and_three_columns():
    assert [len(row) for row in ROWS if len(row) != 3] == [] and len(ROWS) > 100
    assert all(f"## Seed {seed}" in PAGE for seed in ("000", "002", "003", "004"))
    # what has no door says why
    assert all(row[1] or len(row[2]) > 20 for row in ROWS)


@pytest.mark.parametrize("door", DOORS)
def test_every_door_opens(door):
    if ".py" in door:
        path, _, name = door.partition(":")
        module = ROOT / "ladar_volume" / path
        assert module.is_file() and (not name or name in set(names(module)))
    elif door.startswith("study_"):
        assert (ROOT / "docs" / f"{door}.md").is_file()
    elif "." in door.split()[0]:
        section, _, key = door.partition(".")
        assert key in {s.key for s in specs(KEYS[section])}
    else:
        words = door.split()
        verb = [w for w in words if not w.startswith("-")]
        assert verb[0] in MODULES and set(words) - set(verb) <= flags(verb)

"""Help that helps: examples that are commands, near misses that are named, completion, quiet."""

from __future__ import annotations

import shlex
import subprocess

import pytest

from ladar_volume.cli.help.examples import EXAMPLES
from ladar_volume.cli.main import MODULES, main, make_parser


@pytest.mark.parametrize("verb", sorted(EXAMPLES))
def test_examples_are_commands_that_are_understood(verb):
    assert verb in MODULES
    parser = make_parser(verb)
    for _, words in EXAMPLES[verb]:
        assert parser.parse_args([verb, *shlex.split(words)]).verb == verb
        assert (
            f"ladar_volume {verb} {words}"
            in parser._subparsers._group_actions[0].choices[verb].format_help()
        )


@pytest.mark.parametrize(
    "words, near",
    [
        (["volume", "a.ply", "--levle", "1"], "did you mean --level?"),
        (["volume", "a.ply", "--sgima=1"], "did you mean --sigma?"),
        (["volum", "a.ply"], "did you mean volume?"),
        (["replay", "bag", "--ouptut", "x"], "did you mean --output?"),
    ],
)
def test_a_near_miss_is_named_in_one_line(words, near, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    said = capsys.readouterr().err
    assert end.value.code == 2 and near in said and said.count("\n") == 1


def test_what_is_near_nothing_names_nothing(capsys):
    with pytest.raises(SystemExit):
        main(["volume", "a.ply", "--xyzzyx"])
    assert "did you mean" not in capsys.readouterr().err


def test_the_completion_is_a_script_that_bash_reads(capsys):
    pytest.importorskip("shtab", reason="the extra 'completion' is not installed")
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert "--report" in script and "check-config" in script
    subprocess.run(["bash", "-n"], input=script, text=True, check=True)


def test_quiet_prints_errors_and_json_alone(capsys, tmp_path):
    assert main(["--quiet", "check-config", "config/default.yaml"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["--quiet", "info", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("ladar_volume: ")


@pytest.mark.parametrize("verb", ["check-config", "info"])
def test_quiet_stands_before_or_behind_the_verb(capsys, verb):
    of = {"check-config": "config/default.yaml", "info": "bags/box"}[verb]
    for words in (["--quiet", verb, of], [verb, "--quiet", of], [verb, of, "--quiet"]):
        assert main(words) == 0
        assert capsys.readouterr().out == ""
    assert main([verb, of]) == 0 and capsys.readouterr().out


@pytest.mark.parametrize("words", [("replay",), ("calibrate", "strips"), ("study", "nist")])
def test_help_names_quiet_behind_a_verb_and_its_own_verbs(words, capsys):
    with pytest.raises(SystemExit, match="0"):
        main([*words, "--help"])
    assert "--quiet" in capsys.readouterr().out

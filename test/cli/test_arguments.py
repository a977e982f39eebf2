"""A command line is read, and refused, without what the work needs: no compiler, no SciPy, no
pictures.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import pytest

from ladar_volume.cli.help.summaries import SUMMARIES
from ladar_volume.cli.main import MODULES, main

ROOT = Path(__file__).parents[2]
HEAVY = ("numba", "llvmlite", "scipy", "open3d", "matplotlib", "rclpy", "pyproj", "laspy")
#: Runs the command line with these modules blocked: an import of one of them would be an error.
BLOCKED = f"""if True:
    import sys
    for name in {HEAVY!r}:
        sys.modules[name] = None
    from ladar_volume.cli.main import main
    sys.exit(main(sys.argv[1:]))
"""


def blocked(*words):
    return subprocess.run(
        [sys.executable, "-c", BLOCKED, *map(str, words)], cwd=ROOT, capture_output=True, text=True
    )


def test_every_verb_explains_itself_with_little_loaded():
    code = f"""if True:
        import contextlib, io, sys
        for name in {HEAVY!r}:
            sys.modules[name] = None
        from ladar_volume.cli.main import MODULES, main
        for verb in (*MODULES, "info", "check-config"):
            with contextlib.redirect_stdout(io.StringIO()) as out:
                try:
                    main([verb, "--help"])
                except SystemExit as end:
                    assert end.code == 0, verb
            assert f"ladar_volume {{verb}}" in out.getvalue(), verb
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("word", ["--version", "--help"])
def test_the_tool_explains_itself_with_little_loaded(word):
    done = blocked(word)
    assert done.returncode == 0 and "ladar_volume" in done.stdout, done.stderr


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["--quiet", "-h"]])
def test_no_verb_is_loaded_where_none_is_named(words):
    code = f"""if True:
        import contextlib, io, sys
        from ladar_volume.cli.main import MODULES, main
        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
            main({words!r})
        assert "ladar_volume" in out.getvalue()
        loaded = [m for m in ("numpy", "rich", *MODULES.values()) if m in sys.modules]
        assert not loaded, loaded
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_verb_has_its_line_in_the_help():
    assert list(SUMMARIES) == list(MODULES) and all(SUMMARIES.values())
    shown = " ".join(blocked("--help").stdout.split())
    assert all(line in shown for line in SUMMARIES.values())


REFUSED = {
    "unknown verb": (["volum", "a.ply"], "volum"),
    "unknown option": (["volume", "a.ply", "--levle", "1"], "--levle"),
    "no cloud": (["volume", "absent.ply", "--level", "1"], "absent.ply: no such file"),
    "no second cloud": (["volume", "README.md", "absent.ply"], "absent.ply: no such file"),
    "no cloud to filter": (["filter", "absent.ply", "-o", "x.ply"], "absent.ply: no such file"),
    "no mesh": (["body", "absent.ply", "-o", "x.ply"], "absent.ply: no such file"),
    "no scan": (["diff", "absent.ply", "README.md"], "absent.ply: no such file"),
    "no spheres": (["register", "absent.csv", "README.md"], "absent.csv: no such file"),
    "no kind of cloud": (["volume", "README.md", "--level", "1"], ".md is no known kind"),
    "no kind of scan": (["diff", "bags", "README.md"], "bags: no ending is no known kind"),
    "no measurements": (["calibrate", "repeats", "absent.csv"], "absent.csv: no such file"),
    "no survey": (["epochs", "absent", "bags"], "absent: no such file; replay writes it"),
    "no recording": (["replay", "absent"], "absent: no such recording"),
    "no strips": (["calibrate", "strips", "absent"], "absent: no such recording"),
    "no recording to play": (["up", "--play", "absent"], "absent: no such recording"),
    "misspelt key": (["replay", "bags/box", "--set", "filter.radus_m=1"], "'radius_m'"),
    "value out of range": (["up", "--play", "bags/box", "--set", "filter.radius_m=-1"], "radius_m"),
    "misspelt key of a file verb": (
        ["filter", "README.md", "-o", "x.ply", "--set", "filter.radus_m=1"],
        "'radius_m'",
    ),
}


@pytest.mark.parametrize(("words", "said"), REFUSED.values(), ids=REFUSED)
def test_a_command_line_is_refused_before_the_work_is_loaded(words, said):
    done = blocked(*words)
    assert done.returncode == 2 and said in done.stderr, done.stderr
    assert "Traceback" not in done.stderr and "import" not in done.stderr
    assert len(done.stderr.splitlines()) == 1 or done.stderr.startswith("usage:")


def test_the_same_is_refused_where_everything_is_loaded(capsys, monkeypatch):
    monkeypatch.chdir(ROOT)
    assert main(["replay", "bags/box", "--set", "filter.radus_m=1"]) == 2
    said = capsys.readouterr().err
    assert blocked("replay", "bags/box", "--set", "filter.radus_m=1").stderr == said


def test_an_override_counts_beside_the_configuration_file_that_the_work_reads(tmp_path):
    from ladar_volume.cli.arguments.work import config_of

    (tmp_path / "config.yaml").write_text("")
    own, given = tmp_path / "config.yaml", tmp_path / "other.yaml"
    for verb, name in (("replay", "bag"), ("up", "play"), ("calibrate", "bag")):
        line = argparse.Namespace(verb=verb, config=None, **{name: tmp_path})
        assert config_of(line) == own
        line.config = given
        assert config_of(line) == given
    assert config_of(argparse.Namespace(verb="volume", cloud=tmp_path)) is None


def test_every_verb_declares_its_options_apart_from_its_work():
    assert all(".arguments." in module or ".studies." in module for module in MODULES.values())

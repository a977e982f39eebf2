"""The commands of README and docs: every line is read by the real parser, those that are short are
run, targets and benchmarks and files that are named are there.
"""

import contextlib
import io
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ladar_volume.cli.main import MODULES, main, make_parser
from ladar_volume.io.pointfiles.cloud_files import write_cloud

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "bags" / "README.md"]
TEXT = {page: page.read_text(encoding="utf-8") for page in PAGES}
VERBS = (*MODULES, "info", "check-config")


def lines(page):
    """Indented lines of commands, without their comments."""
    for line in TEXT[page].splitlines():
        if re.match(r" {4}(ladar_volume|make|python|\.venv/bin/)\b", line):
            yield re.sub(r"\s+#\s.*", "", line).strip()


def inline(page):
    """Commands of ours within sentences."""
    yield from re.findall(r"`(ladar_volume [^`]+)`", TEXT[page])


COMMANDS = [(p, c) for p in PAGES for c in lines(p) if c.startswith("ladar_volume ")]
SENTENCES = [(p, c) for p in PAGES for c in inline(p)]


def name(value):
    return value.name if isinstance(value, Path) else str(value)


def parsed(command):
    words = shlex.split(command)[1:]
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return make_parser(words[0]).parse_args(words)
    except SystemExit:
        pytest.fail(f"{command}: {said.getvalue()}")


def test_there_are_commands_to_read():
    assert len([c for p, c in COMMANDS if p == PAGES[0]]) >= 20
    shown = {shlex.split(c)[1] for _, c in COMMANDS}
    assert set(VERBS) <= shown  # every verb is shown at least once


@pytest.mark.parametrize(("page", "command"), COMMANDS, ids=name)
def test_the_parser_takes_every_command(page, command):
    assert parsed(command).verb in VERBS


@pytest.mark.parametrize(("page", "command"), SENTENCES, ids=name)
def test_commands_within_sentences_exist(page, command):
    words = shlex.split(command.replace("[", " ").replace("]", " "))[1:]
    if not words[0].startswith("-"):
        assert words[0] in VERBS
    if not re.search(r"\.\.\.|\[", command) and len(words) > 2:
        parsed(command)


def test_no_command_is_refused_that_the_parser_should_refuse():
    with pytest.raises(pytest.fail.Exception, match="--levle"):
        parsed("ladar_volume volume CLOUD.las --levle 12.5")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the clouds that the README names: a mound of 25 points per m² above z = 12.5."""
    rng = np.random.default_rng(5)
    xy = rng.uniform(0.0, 10.0, (2500, 2))
    height = 12.0 + 2.0 * np.exp(-((xy - 5.0) ** 2).sum(axis=1) / 8.0)
    r = np.column_stack([xy, height + rng.normal(0.0, 0.01, len(xy))])
    for cloud in ("CLOUD.ply", "CLOUD.las"):
        write_cloud(tmp_path / cloud, r, {})
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    monkeypatch.chdir(tmp_path)
    return tmp_path


SHORT = {
    "info": "leo_cut",
    "check-config": "good",
    "tin": "tin.ply",
    "volume": '"net_m3"',
    "study stockpile": "Table 2",
}


@pytest.mark.parametrize("start", SHORT)
def test_short_commands_of_the_readme_run(start, folder, capsys):
    command, *_ = [
        c
        for p, c in COMMANDS
        if (p == PAGES[0] and c.startswith(f"ladar_volume {start} "))
        or (p == PAGES[0] and c == f"ladar_volume {start}")
    ]
    assert main(shlex.split(command)[1:]) == 0
    assert SHORT[start] in capsys.readouterr().out


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_targets_that_are_named_are_listed_by_make_help():
    done = subprocess.run(["make", "-s", "help"], cwd=ROOT, capture_output=True, text=True)
    listed = {line.split()[0] for line in done.stdout.splitlines()}
    makefile = (ROOT / "Makefile").read_text()
    phony = set(re.search(r"^\.PHONY: (.*)$", makefile, re.M).group(1).split())
    named = {t for page in PAGES for t in re.findall(r"(?:`|^ {4})make ([a-z]+)", TEXT[page], re.M)}
    assert done.returncode == 0 and listed == phony and named and named <= listed


def test_benchmarks_that_are_named_are_there():
    from benchmarks.__main__ import NAMES

    for page in PAGES:
        for dot, first in re.findall(r"python -m benchmarks(\.| )([a-z_]+)", TEXT[page]):
            path = ROOT / "benchmarks" / f"{first}.py"
            assert path.exists() and (dot or first in NAMES), f"{page.name}: {first}"


ROOMS = r"(?:test|benchmarks|tools|config|launch|ladar_volume|docs|bags|resource)"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_files_that_are_named_are_there(page):
    paths = re.findall(rf"\b({ROOMS}/[\w/.-]+\.(?:py|md|yaml|xml|json|txt|sh|png))\b", TEXT[page])
    links = re.findall(r"\]\((?!https?:)([^)#]+)", TEXT[page])
    assert [p for p in paths if not (ROOT / p).exists()] == []
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_the_module_form_of_the_command_runs():
    done = subprocess.run(
        [sys.executable, "-m", "ladar_volume.cli.main", "--version"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and done.stdout.startswith("ladar_volume ")

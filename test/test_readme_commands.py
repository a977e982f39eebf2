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
VERBS = (*MODULES, "info", "check-config", "completion")


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


def mound(rng):
    """25 points per m², a mound above z = 12.5."""
    xy = rng.uniform(0.0, 10.0, (2500, 2))
    height = 12.0 + 2.0 * np.exp(-((xy - 5.0) ** 2).sum(axis=1) / 8.0)
    return np.column_stack([xy, height + rng.normal(0.0, 0.01, len(xy))])


def pit(rng, depth_m):
    """Level ground of 8 m with a pit of 1 m radius in its middle."""
    xy = rng.uniform(-4.0, 4.0, (4000, 2))
    z = -depth_m * np.exp(-(xy**2).sum(axis=1))
    return np.column_stack([xy, z + rng.normal(0.0, 0.004, len(xy))])


def spheres(rng, shift):
    """Points on four spheres of 0.1 m, and their numbers."""
    centres = np.array([[0.0, 0, 0], [8, 1, 0.5], [3, 7, 1], [-4, 5, 0.3]]) + shift
    u = rng.standard_normal((4, 60, 3))
    u *= (0.1 + rng.normal(0.0, 0.002, (4, 60, 1))) / np.linalg.norm(u, axis=2, keepdims=True)
    return (centres[:, None] + u).reshape(-1, 3), {"sphere": np.repeat(np.arange(4), 60)}


#: A level of 12.2 m below the mound; a point is northing, easting, height.
DESIGN = """<?xml version="1.0"?>
<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2" version="1.2"><Units><Metric
linearUnit="meter" areaUnit="squareMeter" volumeUnit="cubicMeter" temperatureUnit="celsius"
pressureUnit="milliBars"/></Units><Surfaces><Surface name="level"><Definition surfType="TIN"><Pnts>
<P id="1">0 0 12.2</P><P id="2">0 10 12.2</P><P id="3">10 10 12.2</P><P id="4">10 0 12.2</P></Pnts>
<Faces><F>1 2 3</F><F>1 3 4</F></Faces></Definition></Surface></Surfaces></LandXML>
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with the files that the README names."""
    rng = np.random.default_rng(5)
    r = mound(rng)
    for cloud in ("CLOUD.ply", "CLOUD.las", "YARD.laz", "SITE.las"):
        write_cloud(tmp_path / cloud, r, {})
    square = '{"type": "Polygon", "coordinates": [[[1, 1], [9, 1], [9, 9], [1, 9], [1, 1]]]}'
    (tmp_path / "OUTLINES.geojson").write_text(square, encoding="utf-8")
    write_cloud(tmp_path / "A.ply", pit(rng, 0.0), {})
    write_cloud(tmp_path / "B.ply", pit(rng, 1.0), {})
    for name, shift in (("A.csv", 0.0), ("B.csv", [3.0, -2.0, 0.5])):
        write_cloud(tmp_path / name, *spheres(rng, shift))
    (tmp_path / "DESIGN.xml").write_text(DESIGN, encoding="utf-8")
    (tmp_path / "bags").symlink_to(ROOT / "bags")
    monkeypatch.chdir(tmp_path)
    return tmp_path


#: Commands of the README that are run here as they stand, and what they say.
RUN_HERE = {
    "info": "leo_cut",
    "check-config": "good",
    "tin": "tin.ply",
    "volume CLOUD.las": '"net_m3"',
    "volume YARD.laz": "V / m³ by base",
    "volume SITE.las": "net volume",
    "diff": "taken away",
    "register": '"matrix"',
    "study stockpile": "Table 2",
    "tiles": "net volume",
}
#: The others take longer as they stand. Where each verb is run with less.
RUN_ELSEWHERE = {
    "replay bags/stockpile": "test/cli/test_replay.py",
    "replay bags/box": "test/cli/test_plan_verb.py",
    "filter": "test/cli/test_filter_verb.py",
    "simulate": "test/cli/test_calibrate_strips.py",
    "sites": "test/cli/test_sites_verb.py",
    "body": "test/cli/test_body.py",
    "epochs": "test/cli/test_epochs_verb.py",
    "export": "test/cli/test_export.py",
    "calibrate strips": "test/cli/test_calibrate_strips.py",
    "plan": "test/cli/test_plan_verb.py",
    "study nist": "test/experiments/test_nist.py",
    "study coverage": "test/experiments/test_coverage.py",
    "study landfill": "test/experiments/test_landfill.py",
    "study thesis": "test/experiments/test_thesis.py",
    "up": "test/nodes/test_graph.py",
}
OF_README = [c for p, c in COMMANDS if p == PAGES[0]]


def starts(command):
    """The entries of both tables that a command of the README begins with."""
    words = command.split()[1:]
    return [s for s in (*RUN_HERE, *RUN_ELSEWHERE) if words[: len(s.split())] == s.split()]


@pytest.mark.parametrize("command", OF_README)
def test_every_command_of_the_readme_is_run_by_a_test(command):
    (start,) = starts(command)
    if start in RUN_ELSEWHERE:
        text = (ROOT / RUN_ELSEWHERE[start]).read_text(encoding="utf-8")
        called = [w for w in start.split() if "/" not in w]
        assert all(f'"{word}"' in text for word in called), start
        assert "main(" in text or "ladar_volume.cli.main" in text


def test_every_entry_is_a_command_of_the_readme():
    assert {s for c in OF_README for s in starts(c)} == {*RUN_HERE, *RUN_ELSEWHERE}


@pytest.mark.parametrize("start", RUN_HERE)
def test_short_commands_of_the_readme_run(start, folder, capsys):
    command, *_ = [c for c in OF_README if start in starts(c)]
    assert main(shlex.split(command)[1:]) == 0
    assert RUN_HERE[start] in capsys.readouterr().out


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

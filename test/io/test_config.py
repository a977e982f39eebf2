"""Configuration files: generated pages equal their source; strict reading; precedence."""

from pathlib import Path

import pytest

from ladar_volume.io.config import dump_config, parameters_markdown, read_config
from ladar_volume.model.errors import ConfigurationError
from ladar_volume.model.parameters import Parameters

ROOT = Path(__file__).parents[2]


def test_the_default_file_and_the_page_are_generated():
    assert (ROOT / "config" / "default.yaml").read_text() == dump_config(Parameters())
    assert (ROOT / "docs" / "parameters.md").read_text() == parameters_markdown()
    assert repr(read_config(ROOT / "config" / "default.yaml").write()) == repr(Parameters().write())


def written(tmp_path, text):
    file = tmp_path / "config.yaml"
    file.write_text(text)
    return file


def test_default_then_file_then_command_line(tmp_path):
    file = written(tmp_path, "/**:\n  ros__parameters:\n    filter: {radius_m: 0.3, degree: 1}\n")
    p = read_config(file, ["filter.radius_m=0.2", "calibration.lever_laser_m=[1, 2, 3]"]).filter
    assert (p.radius_m, p.degree, p.trials) == (0.2, 1, Parameters().filter.trials)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("/**:\n  ros__parameters:\n    filter: {radius_m: 1.0, radius_m: 2.0}\n", "given twice"),
        ("filter: {radius_m: 1.0}\n", "expected '/**:'"),
        ("/**:\n  ros__parameters:\n    filter: 3\n", "must hold keys"),
        ("/**:\n  ros__parameters:\n    filter: {radius_cm: 3.0}\n", "did you mean 'radius_m'"),
        ("a: [1\n", "not valid YAML"),
    ],
)
def test_bad_files_are_named(tmp_path, text, words):
    with pytest.raises(ConfigurationError) as caught:
        read_config(written(tmp_path, text))
    assert words in str(caught.value) and "config.yaml" in str(caught.value)


@pytest.mark.parametrize("word", ["radius_m=1", "filter.radius_m", "filter.radius_m=wide"])
def test_bad_overrides_are_refused(word):
    with pytest.raises(ConfigurationError):
        read_config(None, [word])

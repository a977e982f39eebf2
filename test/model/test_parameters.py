"""Parameters: one source, strict reading, units at the door."""

import dataclasses
import math

import pytest

from ladar_volume.model.errors import ParameterValueError, UnknownParameterError
from ladar_volume.model.parameter import specs
from ladar_volume.model.parameters import SECTIONS, Parameters


def test_read_and_write_are_inverse():
    outside = Parameters().write()
    assert repr(Parameters.read(outside).write()) == repr(outside)


@pytest.mark.parametrize("section", SECTIONS)
def test_every_default_is_within_its_own_bounds(section):
    outside = Parameters().write()[section]
    Parameters.read({section: outside})


@pytest.mark.parametrize("section", SECTIONS)
def test_every_parameter_has_help_and_every_number_a_name_with_its_unit(section):
    for spec in specs(SECTIONS[section]):
        assert spec.help.endswith("."), spec.key
        suffix = {"m": "_m", "s": "_s", "deg": "_deg", "B": "_bytes"}.get(spec.unit)
        assert suffix is None or spec.key.endswith(suffix), spec.key


def test_angles_are_degrees_outside_and_radians_inside():
    p = Parameters.read(
        {"calibration": {"boresight_pitch_deg": 90}, "budget": {"boresight_sigma_deg": [1, 2, 3]}}
    )
    assert p.calibration.boresight_pitch_rad == pytest.approx(math.pi / 2, rel=1e-15)
    assert p.budget.boresight_sigma_rad == pytest.approx(
        [math.radians(v) for v in (1, 2, 3)], rel=1e-15
    )
    assert p.write()["calibration"]["boresight_pitch_deg"] == 90.0


@pytest.mark.parametrize(
    ("mapping", "error", "words"),
    [
        (
            {"filter": {"radius_cm": 3.0}},
            UnknownParameterError,
            ("filter.radius_cm", "unit suffix", "radius_m"),
        ),
        ({"filter": {"raduis_m": 3.0}}, UnknownParameterError, ("filter.raduis_m", "radius_m")),
        ({"fliter": {}}, UnknownParameterError, ("fliter", "filter")),
        (
            {"filter": {"radius_m": -3.0}},
            ParameterValueError,
            ("filter.radius_m", "-3", "0.001 to 100"),
        ),
        (
            {"filter": {"radius_m": "wide"}},
            ParameterValueError,
            ("filter.radius_m", "wide", "float"),
        ),
        ({"filter": {"radius_m": float("nan")}}, ParameterValueError, ("filter.radius_m", "NaN")),
        ({"filter": {"trials": 2.5}}, ParameterValueError, ("filter.trials", "2.5", "int")),
        ({"filter": {"trials": True}}, ParameterValueError, ("filter.trials", "True")),
        (
            {"filter": {"start": "magic"}},
            ParameterValueError,
            ("filter.start", "magic", "lmeds, ransac"),
        ),
        (
            {"filter": {"outlier_sigmas": 2.0}},
            ParameterValueError,
            ("filter.outlier_sigmas", "3 to 20"),
        ),
        ({"node": {"autostart": 1}}, ParameterValueError, ("node.autostart", "true or false")),
        (
            {"calibration": {"lever_laser_m": [1, 2]}},
            ParameterValueError,
            ("calibration.lever_laser_m", "3 float"),
        ),
        (
            {"calibration": {"boresight_roll_deg": 400}},
            ParameterValueError,
            ("boresight_roll_deg", "400", "deg"),
        ),
    ],
)
def test_bad_values_name_key_value_range_and_nearest(mapping, error, words):
    with pytest.raises(error) as caught:
        Parameters.read(mapping)
    for word in words:
        assert word in str(caught.value)
    assert caught.value.value is not None


def test_later_readings_win_over_earlier_ones():
    file = Parameters.read({"filter": {"radius_m": 0.3, "degree": 1}})
    line = Parameters.read({"filter": {"radius_m": 0.2}}, file)
    assert (line.filter.radius_m, line.filter.degree, line.filter.trials) == (
        0.2,
        1,
        Parameters().filter.trials,
    )


def test_parameters_cannot_be_changed_in_place():
    with pytest.raises(dataclasses.FrozenInstanceError):
        Parameters().filter.radius_m = 1.0  # type: ignore[misc]

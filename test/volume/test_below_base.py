"""What lies below the base of a body that rises above it is named."""

import pytest

from ladar_volume.volume.field_checks.base_readings import below_base, doubted_m6


@pytest.mark.parametrize(
    ("cut", "fill", "sigma", "told"),
    [
        (262.0, 4.1, 0.6, True),  # ruts along the toe
        (262.0, 1.2, 0.1, False),  # less than 0.5 %
        (262.0, 1.7, 0.6, False),  # less than three sigma
        (1.0, 300.0, 0.5, False),  # a pit, with a rim
        (100.0, 150.0, 1.0, True),  # a pile in a deep hollow
        (0.0, 0.0, 0.0, False),
        (262.0, 4.1, float("nan"), False),
    ],
)
def test_a_trench_in_the_outline_is_named_and_a_pit_is_none(cut, fill, sigma, told):
    doubts = below_base(cut, fill, sigma)
    assert [d.name for d in doubts] == ["below_base"] * told
    assert doubted_m6(doubts) == (min(cut, fill) ** 2 if told else 0.0)
    if told:
        assert doubts[0].value == min(cut, fill)
        assert f"{min(cut, fill):.3g} m³" in doubts[0].text

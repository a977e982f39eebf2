"""The benchmarks of pits and spheres give what is asked of them."""

from __future__ import annotations

from benchmarks import pits, spheres


def test_four_pits_within_two_hundredths_of_a_percent_about_any_pole():
    figures = pits.run((0.25,))
    for name in pits.PITS:
        values = {key.split(": ")[1]: v for key, v in figures.items() if key.startswith(name)}
        assert abs(values["error over the common ring, %"]) <= 0.02
        assert abs(values["the same without the outermost points of B, %"]) <= 0.02
        assert values["largest change over nine poles, relative"] < 1e-9
        assert -16 < values["published, without the outermost points of B, %"] < -2


def test_half_seen_spheres():
    figures = spheres.run(200)
    for name in ("free", "known"):
        rms, error = (
            figures[f"radius {name}: RMS of the centre, mm"],
            figures[f"radius {name}: its standard error, mm"],
        )
        assert rms <= figures[f"radius {name}: measured elsewhere, mm"] + 2 * error
        assert abs(figures[f"radius {name}: predicted over empirical sigma"] - 1) <= 0.10

"""What speaks against the answer of a cloud filter."""

from __future__ import annotations

from collections.abc import Mapping

from ladar_volume.model.verdict import Doubt, Verdict

#: Share of the points on no surface from which on the cloud is hardly one of surfaces.
MUCH = 0.5


def doubts(report: Mapping[str, float | int | str], told: bool) -> Verdict:
    """The verdict on a result, from its report and whether the cloud ``told`` its noise."""
    out = []
    points = max(int(report["points"]), 1)
    if not told:
        noise = float(report["noise_m"])
        out.append(
            Doubt(
                "filter_noise_unknown",
                f"the noise cannot be told, since no place holds several lines of points: "
                f"{noise:.4g} m, half the spacing along the lines, stands in; add sweeps or "
                f"stations",
                noise,
            )
        )
    for name, words in (
        ("sparse", "too sparse for a surface and as they came: add sweeps or stations"),
        ("clutter", "on several surfaces at once and taken out: --keep clutter keeps them"),
    ):
        share = int(report.get(name, 0)) / points
        if share > MUCH:
            out.append(
                Doubt(f"filter_{name}", f"{100 * share:.1f} % of the points are {words}", share)
            )
    return Verdict(tuple(out))

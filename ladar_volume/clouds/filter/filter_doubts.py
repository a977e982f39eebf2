"""What speaks against the answer of a cloud filter."""

from __future__ import annotations

from collections.abc import Mapping

from ladar_volume.model.verdict import Doubt, Verdict

#: Share of sparse points above which the answer is mostly the cloud as it came.
MOSTLY_SPARSE = 0.5
#: Share of removed points above which the filter may have removed part of the survey. Real sweeps
#: and airborne samples of ground and buildings lose 3 to 14 %, forests 20 to 50 %.
MUCH_REMOVED = 0.15
#: Why points are removed, by the names of ``filter_result.REASONS``, in words.
REMOVED_AS = {
    "outlier": "far from the surfaces beside them",
    "few_neighbours": "with too few neighbours",
    "no_surface": "where no surface was found",
    "beyond_edge": "beyond the edge of their surface",
    "unsupported": "on surfaces that those beside them do not continue",
    "clutter": "on several surfaces at once (--keep clutter keeps them)",
}


def doubts(report: Mapping[str, float | int | str], noise_known: bool) -> Verdict:
    """The verdict on a result, from its report and whether the noise is known."""
    out = []
    points = max(int(report["points"]), 1)
    if not noise_known:
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
    sparse = int(report.get("sparse", 0)) / points
    if sparse > MOSTLY_SPARSE:
        words = "of the points are too sparse for a surface and as they came"
        out.append(
            Doubt("filter_sparse", f"{100 * sparse:.1f} % {words}: add sweeps or stations", sparse)
        )
    removed = 1.0 - int(report["kept"]) / points
    if removed > MUCH_REMOVED:
        name = max(REMOVED_AS, key=lambda reason: int(report.get(reason, 0)))
        share = int(report.get(name, 0)) / points
        out.append(
            Doubt(
                "filter_removed",
                f"{100 * removed:.1f} % of the points were taken out, {100 * share:.1f} % "
                f"{REMOVED_AS[name]}: trees and plants have no surface of their own; compare what "
                f"is left with the cloud, or filter the classes of ground and buildings alone "
                f"(--classes 2,6)",
                removed,
            )
        )
    return Verdict(tuple(out))

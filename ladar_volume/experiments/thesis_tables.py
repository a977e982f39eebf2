"""The thesis's tables, simulated beside published, as Markdown, and the figure of all errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ladar_volume.clouds.published.filter_presets import PRESETS
from ladar_volume.experiments.nist.nist_figures import panels
from ladar_volume.experiments.nist.nist_tables import markdown, with_spread
from ladar_volume.experiments.thesis import Body, Field, Study, errors_pct
from ladar_volume.experiments.thesis_scene import BOX_M3, SPHERE_M3, SQUARE_POINTS
from ladar_volume.model.choices import REPAIRS
from ladar_volume.report.plates import save_figure

#: Names of the ways to repair as printed.
NAMES = {
    "none": "none",
    "empty": "'empty'",
    "false": "'false'",
    "both": "'false' + 'empty'",
    "remove": "remove all suspicious",
}
#: Triangles and volume, cm³, of Tables 9.3 and 9.4.
TABLE_9_3 = {
    "none": (11127, 1059105),
    "empty": (11133, 1060150),
    "false": (10851, 1030849),
    "both": (10855, 1031362),
    "remove": (10550, 1001199),
}
TABLE_9_4 = {
    "none": (2681, 4154501),
    "empty": (2690, 4163056),
    "false": (2668, 4136695),
    "both": (2677, 4179051),
    "remove": (2626, 4069415),
}
#: Printed of the clouds: raw, filtered, triangles, and seconds of filter and mesh; NaN where
#: nothing is printed.
PRINTED = {
    "bench and fountain": (135_100, 18_000, np.nan, 300.0, np.nan),
    "box": (5800, 5100, 10_650, 70.0, 500.0),
    "sphere": (2200, 1800, 3724, 130.0, 250.0),
    "square": (2_700_000, 300_000, 600_000, 20 * 3600.0, 14 * 3600.0),
}


def settings() -> str:
    """Tables 9.1 and 9.2 as this package's keys."""
    keys = sorted({key for values in PRESETS.values() for key in values})
    rows = [[f"`{key}`", *(str(PRESETS[name].get(key, "")) for name in PRESETS)] for key in keys]
    return markdown(["key of `filter`", *PRESETS], rows)


def volumes(bodies: list[Body], truth_m3: float, printed: dict[str, tuple[int, int]]) -> str:
    """Table 9.3 or 9.4."""
    error = errors_pct(bodies, truth_m3)
    rows = []
    for way in REPAIRS:
        triangles, volume = printed[way]
        off = 100.0 * (volume / (1e6 * truth_m3) - 1.0)
        counts = mesh_counts(bodies, way)
        rows.append(
            [NAMES[way], str(triangles), f"{off:+.2f}", *counts, with_spread(error[way], ".2f")]
        )
    own = [b.own for b in bodies]
    closed = "watertight" if all(o.watertight for o in own) else "not closed"
    counts = [
        f"{np.mean([o.triangles for o in own]):.0f}",
        "0",
        "0" if closed == "watertight" else "",
    ]
    rows.append([f"own way ({closed})", "", "", *counts, with_spread(error["own way"], ".2f")])
    rows.append(
        [
            "own way, edges and curvature not corrected",
            "",
            "",
            "",
            "",
            "",
            with_spread(error["own way, not corrected"], ".2f"),
        ]
    )
    head = [
        "check",
        "triangles, printed",
        "error, %, printed",
        "triangles",
        "edges with 3 or more",
        "open edges",
        "error, %",
    ]
    return markdown(head, rows)


def mesh_counts(bodies: list[Body], way: str) -> list[str]:
    """Triangles, edges with three or more of them, and open edges, in the mean."""
    modes = [b.modes[way] for b in bodies]
    return [
        f"{np.mean([getattr(m, name) for m in modes]):.0f}"
        for name in ("triangles", "over_full", "open")
    ]


def body_rows(name: str, bodies: list[Body]) -> list[list[str]]:
    """Two rows of :func:`work`: the published way, and the package's own."""
    first, own = bodies[0], bodies[0].own
    filtering = min(b.seconds for b in bodies)
    meshing = min(b.modes["both"].seconds for b in bodies)
    every = min(b.own.seconds for b in bodies)
    published = (first.filtered_points, first.modes["both"].triangles, filtering, meshing)
    own_way = [f"{name}, own way (all steps)", "", f"{own.points:,}", "", f"{own.triangles:,}"]
    return [
        cloud_row(name, f"{name}, published", published),
        [*own_way, "", f"{every:.2g}", "", ""],
    ]


def work(study: Study) -> str:
    """What came out of filter and mesh, and how long it took."""
    rows = body_rows("box", study.boxes) + body_rows("sphere", study.spheres)
    for name, f in study.fields.items():
        key = (
            "bench and fountain"
            if name.startswith("bench")
            else "square"
            if f.raw >= SQUARE_POINTS
            else ""
        )
        rows.append(cloud_row(key, name, (f.filtered, f.triangles, f.seconds[0], f.seconds[1])))
    head = [
        "cloud",
        "filtered, printed",
        "filtered",
        "triangles, printed",
        "triangles",
        "filter, s, printed",
        "filter, s",
        "mesh, s, printed",
        "mesh, s",
    ]
    return markdown(head, rows)


def cloud_row(printed: str, name: str, values: tuple[int, int, float, float]) -> list[str]:
    """One row of :func:`work`."""
    p = PRINTED.get(printed, (np.nan,) * 5)
    text = ["" if np.isnan(v) else f"{v:,.0f}" for v in p]
    filtered, triangles, one, two = values
    return [
        name,
        text[1],
        f"{filtered:,}",
        text[2],
        f"{triangles:,}",
        text[3],
        f"{one:.2g}",
        text[4],
        f"{two:.2g}",
    ]


def grounds(fields: dict[str, Field]) -> str:
    """Section 9.3, and what the meshes of the clouds are."""
    rows = []
    for name, f in fields.items():
        share = (
            "" if np.isnan(f.edges_before) else f"{100 * f.over_full_before / f.edges_before:.3f} %"
        )
        ground = [f"{1e3 * f.height_m:+.2f}", f"{1e3 * f.tilt_rad:.2f}", f"{f.seconds[2]:.2g}"]
        rows.append([name, f"{f.raw:,}", *ground, share, str(f.over_full)])
    head = [
        "cloud",
        "points",
        "height off, mm",
        "tilt off, mrad",
        "ground, s",
        "edges with 3 or more before",
        "after",
    ]
    return markdown(head, rows)


def tables(study: Study) -> str:
    """All tables as one Markdown page."""
    parts = {
        "Tables 9.1 and 9.2: settings": settings(),
        "Table 9.3: cube of 1 m³": volumes(study.boxes, BOX_M3, TABLE_9_3),
        "Table 9.4: sphere of 4.19 m³": volumes(study.spheres, SPHERE_M3, TABLE_9_4),
        "Clouds, meshes and times": work(study),
        "Ground (section 9.3) and edges": grounds(study.fields),
    }
    head = f"# Chapter 9 of seed 002, repeated ({len(study.boxes)} clouds each of box and sphere)\n"
    return head + "".join(f"\n## {name}\n\n{text}" for name, text in parts.items())


def write_figure(study: Study, folder: Path) -> str:
    """Errors of every way, box and sphere, as volumes.png; returns its name. Raises
    :class:`OutputError`.
    """
    figure, axes = panels(1, 2, 5.6, 3.8)
    for ax, bodies, truth, printed, name in (
        (axes[0, 0], study.boxes, BOX_M3, TABLE_9_3, "cube"),
        (axes[0, 1], study.spheres, SPHERE_M3, TABLE_9_4, "sphere"),
    ):
        error = errors_pct(bodies, truth)
        for k, (way, values) in enumerate(error.items()):
            ax.plot(values, np.full(len(values), k), "o", ms=4, alpha=0.6, color="C0")
            if way in printed:
                ax.plot(100.0 * (printed[way][1] / (1e6 * truth) - 1.0), k, "x", color="C3")
        ax.axvline(0.0, color="black", lw=0.6)
        ax.set(
            yticks=range(len(error)),
            yticklabels=list(error),
            xlabel="error of the volume / %",
            title=f"{name}; crosses: published",
        )
    return save_figure(figure, folder / "volumes.png")

"""The report of a volume: one self-contained HTML page, and the same as JSON.

The digest of the result is that of its JSON as the tool writes it (``result.json``, or what
``--json`` prints): ``sha256sum`` of that file must give it. With the digest of the input it binds
report, result and data together.
"""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from ladar_volume.io.results import json_text, write_text
from ladar_volume.model.parameters import Parameters
from ladar_volume.report.plates import plates
from ladar_volume.report.scene import Scene
from ladar_volume.version import version

TEMPLATE = "report.html.j2"
#: Packages whose versions a result may depend on.
LIBRARIES = ("numpy", "scipy", "numba", "pyproj")
#: What the figures are called, in the order of the page.
CAPTIONS = {
    "heights": "Surface with its toe.",
    "cut-fill": "Height of the surface above the base.",
    "sigma": "Standard deviation of the heights; marks: not seen, and where another pass helps.",
    "residuals": "How far apart the surfaces seen at different times lie, place by place.",
    "path": "Path of the scanner by the status of its fixes.",
    "section-1": "Section through the middle, west to east.",
    "section-2": "Section through the middle, south to north.",
    "convergence": "Volume and its standard deviation over the recording.",
    "budget": "Standard deviation of the volume by source.",
}


@dataclass(frozen=True)
class Report:
    """title : of the page · result : as in the JSON of the verb · lead : what a reader needs first,
    name and words · tables : by title, rows of name and words · scene : of the maps · inputs :
    sha256 of the input by name
    """

    title: str
    result: Mapping[str, Any]
    lead: Mapping[str, str]
    tables: Mapping[str, list[tuple[str, ...]]]
    scene: Scene
    inputs: Mapping[str, str]


def write_report(report: Report, page: Path) -> None:
    """Write the page and, beside it with the ending .json, its twin. Raises OutputError."""
    figures = plates(report.scene, report.result["budget_m6"])
    twin = twin_of(report, figures)
    write_text(page.with_suffix(".json"), json_text(twin))
    write_text(page, page_text(report, figures, twin))


def twin_of(report: Report, figures: Mapping[str, str]) -> dict[str, Any]:
    """What the page says, as plain values."""
    return {
        "title": report.title,
        "result": dict(report.result),
        "coordinates": report.scene.where,
        "tables": {name: [list(row) for row in rows] for name, rows in report.tables.items()},
        "figures": {name: CAPTIONS[name] for name in figures},
        "versions": versions(),
        "sha256": {"input": dict(report.inputs), "result": digest(report.result)},
    }


def page_text(report: Report, figures: Mapping[str, str], twin: Mapping[str, Any]) -> str:
    """The page."""
    folder = FileSystemLoader(Path(__file__).parent)
    template = Environment(
        loader=folder, autoescape=True, undefined=StrictUndefined, trim_blocks=True
    ).get_template(TEMPLATE)
    shown = [(name, CAPTIONS[name], figures[name]) for name in CAPTIONS if name in figures]
    return template.render(report=report, twin=twin, figures=shown) + "\n"


def digest(result: Mapping[str, Any]) -> str:
    """sha256 of a result as the tool writes it."""
    return hashlib.sha256(json_text(result).encode()).hexdigest()


def file_digest(path: Path) -> str:
    """sha256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def versions() -> dict[str, str]:
    """Of this package, Python and the libraries that compute."""
    found = {name: metadata.version(name) for name in LIBRARIES}
    return {"ladar_volume": version(), "Python": platform.python_version(), **found}


def changed_parameters(parameters: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Parameters (as written) that differ from their defaults: name, value, default."""
    usual = Parameters().write()
    out: list[tuple[str, ...]] = []
    for section, keys in parameters.items():
        for key, value in keys.items():
            default = usual[section].get(key)
            if value != default:
                out.append((f"{section}.{key}", _brief(value), _brief(default)))
    return out


def _brief(value: object) -> str:
    text = "–" if value is None else str(value)
    return text if len(text) <= 80 else text[:79] + "…"

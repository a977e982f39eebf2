"""Configuration files: strict YAML in the ROS layout, and the generated default file and parameter
page.

``/**: ros__parameters: section: key: value`` is read alike by ``--params-file`` and by this
package, which unlike rclpy refuses keys that nobody declares. Precedence: default < file < command
line. ``python -m ladar_volume.io.config`` regenerates config/default.yaml and docs/parameters.md.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ladar_volume.io import strict_yaml
from ladar_volume.model.cloud_filter_parameters import FILTERS
from ladar_volume.model.errors import ConfigurationError, short_repr
from ladar_volume.model.parameter import ParameterSpec, specs, write_section
from ladar_volume.model.parameters import SECTIONS, Parameters

#: What every node of ROS has beside its own parameters.
ROS_OWN = ("use_sim_time", "qos_overrides", "start_type_description_service", "config_file")


def read_config(
    path: str | Path | None, overrides: Sequence[str] = (), start: Parameters | None = None
) -> Parameters:
    """Parameters from defaults (or ``start``), then the file, then ``section.key=value`` overrides.

    Raises ConfigurationError (or a leaf of it) naming file, key, value, range and the nearest known
    key.
    """
    parameters = Parameters() if start is None else start
    if path is not None:
        try:
            parameters = Parameters.read(sections_of(strict_yaml.read_yaml(Path(path))), parameters)
        except ConfigurationError as error:
            raise type(error)(f"{path}: {error}", value=error.value) from error
    for text in overrides:
        parameters = Parameters.read(override(text), parameters)
    return parameters.checked()


def sections_of(document: object) -> dict[str, Any]:
    """The sections of a document below ``/**`` or, as ``ros2 param dump`` writes them, below the
    nodes' names. Raises :class:`ConfigurationError` for another layout.
    """
    if document is None:
        return {}
    layout = "expected '/**:' or a node's name with 'ros__parameters:' below it"
    if not isinstance(document, dict):
        raise ConfigurationError(layout, value=document)
    sections: dict[str, Any] = {}
    for inner in document.values():
        if not isinstance(inner, dict) or set(inner) != {"ros__parameters"}:
            raise ConfigurationError(layout, value=inner)
        values = inner["ros__parameters"] or {}
        if not isinstance(values, dict):
            raise ConfigurationError(layout, value=values)
        _merge(sections, values)
    return sections


def _merge(sections: dict[str, Any], node: Mapping[str, Any]) -> None:
    """Add a node's sections; what ROS itself keeps there is no parameter of ours."""
    for section, values in node.items():
        if section in ROS_OWN:
            continue
        if values is not None and not isinstance(values, dict):
            raise ConfigurationError(
                f"section {short_repr(section)} must hold keys, not {short_repr(values)}",
                value=values,
            )
        there = sections.setdefault(section, {})
        for key, value in (values or {}).items():
            if key in there and repr(there[key]) != repr(value):
                both = f"{short_repr(there[key])} for one node, {short_repr(value)} for another"
                raise ConfigurationError(f"{section}.{key}: {both}", value=value)
            there[key] = value


def override(text: str) -> dict[str, dict[str, Any]]:
    """``section.key=value`` as ``{section: {key: value}}``; raises a ConfigurationError."""
    name, equals, value = text.partition("=")
    section, dot, key = name.strip().partition(".")
    if not equals or not dot:
        raise ConfigurationError(f"{short_repr(text)} is not section.key=value", value=text)
    try:
        return {section: {key: strict_yaml.parse_yaml(value)}}
    except ConfigurationError as error:
        raise ConfigurationError(f"{short_repr(text)}: {error}", value=text) from error


def dump_config(parameters: Parameters) -> str:
    """The whole configuration as YAML text, every key with unit, range and help as a comment."""
    lines = [
        "# Every parameter with its default. Keys carry their unit; angles are degrees.",
        "/**:",
        "  ros__parameters:",
    ]
    for section, values in parameters.write().items():
        lines.append(f"    {section}:")
        for spec in specs(SECTIONS[section]):
            lines.append(f"      # {spec.help} [{_bounds(spec)}]")
            lines.append(f"      {spec.key}: {_yaml(values[spec.key])}")
    return "\n".join(lines) + "\n"


def changed_config(
    parameters: Parameters, kept: Mapping[str, Mapping[str, Any]], comment: str
) -> str:
    """A configuration as YAML text with a comment above: what differs from the defaults, and the
    keys of ``kept`` in any case.
    """
    default, sections = Parameters().write(), {}
    for section, values in parameters.write().items():
        wanted = {
            k: v
            for k, v in values.items()
            if k in kept.get(section, {}) or repr(v) != repr(default[section][k])
        }  # NaN equals NaN
        if wanted:
            sections[section] = wanted
    lines = [f"# {comment}", "/**:", "  ros__parameters:"]
    for section, values in sections.items():
        lines += [
            f"    {section}:",
            *(f"      {key}: {_yaml(value)}" for key, value in values.items()),
        ]
    return "\n".join(lines) + "\n"


def _yaml(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10000).strip()
    return text.removesuffix("...").strip()


def _bounds(spec: ParameterSpec) -> str:
    unit = f" {spec.unit}" if spec.unit else ""
    return f"{spec.range_text}{unit}"


def _table(title: str, cls: type) -> list[str]:
    """Heading and rows of the page for one class."""
    values = write_section(cls())
    rows = [
        f"| `{s.key}` | `{_yaml(values[s.key])}` | {_bounds(s)} | {s.help} |" for s in specs(cls)
    ]
    head = ["| key | default | range | meaning |", "|---|---|---|---|"]
    return [f"## {title}", "", inspect.cleandoc(cls.__doc__ or ""), "", *head, *rows, ""]


def parameters_markdown() -> str:
    """The parameter page of the documentation."""
    lines = [
        "# Parameters",
        "",
        "Generated from `ladar_volume/model/parameters.py` by `make docs`.",
        "",
    ]
    for section, cls in SECTIONS.items():
        lines += _table(section, cls)
    lines += [
        "# Parameters of the filters of point cloud files",
        "",
        "From the command line, `ladar_volume filter CLOUD -o OUT --set filter.KEY=VALUE`, "
        "not from a file.",
        "",
    ]
    for order, kind in FILTERS.items():
        lines += _table(f"filter.order={order}", kind)
    return "\n".join(lines)


def main() -> None:
    """Write config/default.yaml and docs/parameters.md into the source tree."""
    root = Path(__file__).resolve().parents[2]
    (root / "config" / "default.yaml").write_text(dump_config(Parameters()), encoding="utf-8")
    (root / "docs" / "parameters.md").write_text(parameters_markdown(), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Parameters as ROS sees them: descriptors with ranges from the one declaration, and which of them
may change when.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter

from ladar_volume.model.parameter import ParameterSpec
from ladar_volume.model.parameters import SECTIONS, Parameters

#: Read once, when the node starts or is configured.
AT_START = frozenset(
    {"node.input_reliability", "node.input_depth", "node.autostart", "volume.kind"}
)
#: What a node may read, write or delete, and where, files, devices and addresses: given when it is
#: launched, never over the graph.
FILES = frozenset(
    {
        *("logger.path", "logger.disk_full", "node.output_folder"),
        *("mavlink.url", "mavlink.signing_key_file"),
    }
)


def check_given(given: Mapping[str, Parameter], start: Parameters) -> None:
    """Raises :class:`ConfigurationError` for a parameter given at the start that is in a section of
    this package and is none, or has a wrong value.
    """
    values: dict[str, dict[str, Any]] = {}
    for name, parameter in given.items():
        section, _, key = name.partition(".")
        if key and section in SECTIONS and parameter.value is not None:
            values.setdefault(section, {})[key] = plain_value(parameter.value)
    Parameters.read(values, start)


def descriptor(spec: ParameterSpec) -> ParameterDescriptor:
    """Help, unit and range of a parameter."""
    unit = f" [{spec.unit}]" if spec.unit else ""
    d = ParameterDescriptor(
        description=f"{spec.help}{unit}", additional_constraints=spec.range_text
    )
    # an empty list has no element type, and NaN fails every range check: these are checked by this
    # package alone
    d.dynamic_typing = spec.vector == 0
    finite = not (isinstance(spec.default, float) and not math.isfinite(spec.default))
    if spec.vector is None and finite and (spec.low is not None or spec.high is not None):
        if spec.kind is float:
            low, high = (
                (-1e308 if spec.low is None else spec.low),
                (1e308 if spec.high is None else spec.high),
            )
            d.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(high))
            ]
        elif spec.kind is int:
            low, high = (
                (-(2**62) if spec.low is None else spec.low),
                (2**62 if spec.high is None else spec.high),
            )
            d.integer_range = [IntegerRange(from_value=int(low), to_value=int(high))]
    return d


def plain_value(value: Any) -> Any:
    """A parameter's value as this package's own reader takes it."""
    if value is None:
        return []
    return value if isinstance(value, str | int | float | bool) else list(value)


def launch_refusal(name: str) -> str | None:
    """Why a parameter cannot change once its node was launched; None where it can."""
    if name in FILES:
        return (
            f"{name} says what the node may touch of this machine: it is set at launch and "
            "read-only afterwards; restart the node with another value"
        )
    return None


def runtime_refusal(name: str, runtime_sections: tuple[str, ...]) -> str | None:
    """Why a parameter cannot change while its node is configured; None where it can."""
    if name in AT_START:
        return f"{name} is read when the node is configured: clean the node up first, or restart it"
    if name.partition(".")[0] not in runtime_sections:
        return (
            f"{name} cannot change while the node is configured: data taken in so far was "
            "shaped by it; clean the node up first"
        )
    return None

"""One source for every parameter: what a parameter declaration is, and strict reading of mappings.

A stage's parameters are a frozen dataclass whose fields come from :func:`param`. ROS declarations,
YAML keys, ``config/default.yaml``, the parameter page and command-line flags all derive from
:func:`specs`. Angles are radians inside (``*_rad``) and degrees at the door (key ``*_deg``).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from ladar_volume.model.errors import (
    ParameterValueError,
    UnknownParameterError,
    as_float,
    short_repr,
)

#: Of a longer key its beginning alone is compared with the known ones.
LONGEST_KEY = 100
P = TypeVar("P")
N = TypeVar("N", int, float)
Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter as the outside sees it: key, type, default, unit, bounds, choices and help."""

    name: str
    key: str
    kind: type
    vector: int | None
    default: Value | None
    unit: str
    help: str
    low: float | None
    high: float | None
    choices: tuple[str, ...] | None

    @property
    def range_text(self) -> str:
        """The allowed values in words."""
        if self.choices is not None:
            return "one of " + ", ".join(self.choices)
        if self.kind is bool:
            return "true or false"
        if self.low is None and self.high is None:
            return "any"
        low = "-inf" if self.low is None else f"{self.low:g}"
        high = "inf" if self.high is None else f"{self.high:g}"
        return f"{low} to {high}"


def param(
    default: Value | None,
    help: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    vector: int | None = None,
) -> Any:
    """Declare a parameter. Bounds of angles are given in degrees. ``vector``: length of a tuple, 0
    for any length. A default of None: not given.
    """
    metadata = {
        "unit": unit,
        "help": help,
        "low": low,
        "high": high,
        "choices": choices,
        "vector": vector,
    }
    return dataclasses.field(default=default, metadata=metadata)


def _is_angle(name: str) -> bool:
    return name.endswith("_rad")


def _to_outside(name: str, value: object) -> Any:
    if _is_angle(name):
        # 12 significant digits hide the rounding of the degree-radian-degree trip
        angles = typing.cast("tuple[float, ...]", value if isinstance(value, tuple) else (value,))
        degrees = [float(f"{math.degrees(v):.12g}") for v in angles]
        return tuple(degrees) if isinstance(value, tuple) else degrees[0]
    return value


#: What :func:`specs` has read: hints are slow to resolve, and options ask for each by its name.
_SPECS: dict[type, tuple[ParameterSpec, ...]] = {}


def specs(cls: type) -> tuple[ParameterSpec, ...]:
    """The declarations of a parameter dataclass, in order, with keys, defaults and bounds as the
    outside sees them. Fields that no :func:`param` declares are for callers in Python alone.
    """
    if cls not in _SPECS:
        _SPECS[cls] = _declared(cls)
    return _SPECS[cls]


def _declared(cls: type) -> tuple[ParameterSpec, ...]:
    """:func:`specs`, from the class itself."""
    hints = typing.get_type_hints(cls)
    out = []
    for f in dataclasses.fields(cls):
        if not f.metadata:
            continue
        m, hint = f.metadata, hints[f.name]
        if isinstance(hint, types.UnionType):
            hint = next(h for h in typing.get_args(hint) if h is not types.NoneType)
        kind = typing.get_args(hint)[0] if m["vector"] is not None else hint
        angle = _is_angle(f.name)
        key = f.name[:-4] + "_deg" if angle else f.name
        unit = "deg" if angle else m["unit"]
        out.append(
            ParameterSpec(
                f.name,
                key,
                kind,
                m["vector"],
                _to_outside(f.name, f.default),
                unit,
                m["help"],
                m["low"],
                m["high"],
                m["choices"],
            )
        )
    return tuple(out)


def _scalar(section: str, spec: ParameterSpec, value: object) -> bool | int | float | str:
    where = f"{section}.{spec.key}"
    expected = spec.kind.__name__
    if spec.kind is bool:
        if isinstance(value, bool):
            return value
    elif spec.kind is int:
        if isinstance(value, int) and not isinstance(value, bool):
            if abs(value) >= 2**63:
                raise ParameterValueError(f"{where}: {short_repr(value)} is too large", value=value)
            return _check_bounds(where, spec, value)
    elif spec.kind is float:
        if isinstance(value, int | float) and not isinstance(value, bool):
            if value != value and not (
                isinstance(spec.default, float) and math.isnan(spec.default)
            ):
                raise ParameterValueError(
                    f"{where}: NaN is not allowed (allowed: {spec.range_text})", value=value
                )
            return _check_bounds(where, spec, as_float(value))
    elif isinstance(value, str):
        if spec.choices is not None and value not in spec.choices:
            raise ParameterValueError(
                f"{where}: {short_repr(value)} is not allowed (allowed: {spec.range_text})",
                value=value,
            )
        return value
    raise ParameterValueError(
        f"{where}: {short_repr(value)} is not a {expected} (allowed: {spec.range_text})",
        value=value,
    )


def _check_bounds(where: str, spec: ParameterSpec, value: N) -> N:
    too_low = spec.low is not None and value < spec.low
    too_high = spec.high is not None and value > spec.high
    if too_low or too_high:
        unit = f" {spec.unit}" if spec.unit else ""
        raise ParameterValueError(
            f"{where}: {as_float(value):g}{unit} is out of range (allowed: "
            f"{spec.range_text}{unit})",
            value=value,
        )
    return value


def convert(section: str, spec: ParameterSpec, value: object) -> Any:
    """A value from outside, checked against its declaration and converted to the inside unit.

    Raises :class:`ParameterValueError` naming key, value and allowed range.
    """
    if spec.vector is None:
        inside = _scalar(section, spec, value)
        return math.radians(float(inside)) if _is_angle(spec.name) else inside
    if not isinstance(value, list | tuple) or (spec.vector and len(value) != spec.vector):
        size = f"{spec.vector} " if spec.vector else ""
        wanted = f"a list of {size}{spec.kind.__name__} values"
        raise ParameterValueError(
            f"{section}.{spec.key}: {short_repr(value)} is not {wanted}", value=value
        )
    items = tuple(_scalar(section, spec, v) for v in value)
    return tuple(math.radians(float(v)) for v in items) if _is_angle(spec.name) else items


def _unknown(section: str, key: str, known: list[str]) -> UnknownParameterError:
    # a wrong unit suffix leaves the stem equal: look for that first, then for the nearest spelling
    key = key[:LONGEST_KEY]
    stem = key.rsplit("_", 1)[0]
    same_stem = [k for k in known if k.rsplit("_", 1)[0] == stem and "_" in key]
    near = same_stem or difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    where = f"{section}.{key}" if section else key
    hint = ""
    if same_stem:
        hint = f"; the unit suffix is wrong: did you mean {near[0]!r}?"
    elif near:
        hint = f"; did you mean {near[0]!r}?"
    return UnknownParameterError(f"unknown parameter {short_repr(where)}{hint}", value=key)


def read_section(
    cls: type[P], section: str, mapping: Mapping[str, Any], start: P | None = None
) -> P:
    """A parameter object from outside keys and values, on top of ``start`` (default: the declared
    defaults). A key that the class names as ``elsewhere`` is refused with the words given there.
    """
    by_key = {s.key: s for s in specs(cls)}
    changes = {}
    for key, value in mapping.items():
        if key not in by_key and key in getattr(cls, "elsewhere", {}):
            where = cls.elsewhere[key]  # type: ignore[attr-defined]
            raise UnknownParameterError(f"{section}.{key} {where}", value=key)
        if key not in by_key:
            raise _unknown(section, str(key), list(by_key))
        changes[by_key[key].name] = convert(section, by_key[key], value)
    before = start if start is not None else cls()
    return dataclasses.replace(before, **changes)  # type: ignore[type-var]


def write_section(parameters: object) -> dict[str, Any]:
    """The outside keys and values of a parameter object; the inverse of :func:`read_section`."""
    out = {}
    for spec in specs(type(parameters)):
        value = _to_outside(spec.name, getattr(parameters, spec.name))
        out[spec.key] = list(value) if isinstance(value, tuple) else value
    return out


def unknown_section(section: str, known: list[str]) -> UnknownParameterError:
    """The error for a section that no stage declares."""
    return _unknown("", section, known)

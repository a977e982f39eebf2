"""Python classes of message types by name, where their package is installed."""

from __future__ import annotations

import importlib
from typing import Any

from ladar_volume.model.errors import ConfigurationError


def message_class(kind: str) -> Any:
    """The Python class of ``package/msg/Name``; None where the package is not installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        return None


def needed_class(kind: str) -> Any:
    """The same. Raises ConfigurationError that says what to install."""
    found = message_class(kind)
    if found is None:
        package = kind.partition("/")[0]
        raise ConfigurationError(
            f"{kind} needs the package {package}, which is not installed: "
            f"apt install ros-jazzy-{package.replace('_', '-')}",
            value=kind,
        )
    return found


def type_name(message_type: type[Any]) -> str:
    """``package/msg/Name`` of a class."""
    return f"{message_type.__module__.partition('.')[0]}/msg/{message_type.__name__}"

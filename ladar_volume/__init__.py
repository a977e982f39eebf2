"""Volumes from LiDAR surveys with propagated covariance. An import changes nothing outside.

``import ladar_volume as lv`` gives ``lv.read``, ``lv.volume``, ``lv.filter`` and ``lv.replay``,
with the numbers of the command line; each is loaded when it is first used (``ladar_volume.api``).
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ladar_volume.api.verbs import filter as filter
    from ladar_volume.api.verbs import read as read
    from ladar_volume.api.verbs import replay as replay
    from ladar_volume.api.verbs import volume as volume

#: Functions of ``ladar_volume.api.verbs``; of these some are called like a room.
_VERBS, _ROOMS = ("read", "volume", "filter", "replay"), ("volume", "replay")


class _CallableRoom(ModuleType):
    """A room that is called like a verb: as a function it is the verb."""

    def __call__(self, *args: Any, **options: Any) -> Any:
        """The verb, :mod:`ladar_volume.api.verbs`."""
        return _verb(self.__name__.rpartition(".")[2])(*args, **options)


class _Package(ModuleType):
    """This package. Whoever imports a room that is called like a verb makes it callable."""

    def __setattr__(self, name: str, value: object) -> None:
        if name in _ROOMS and isinstance(value, ModuleType):
            value.__class__ = _CallableRoom
        super().__setattr__(name, value)


def _verb(name: str) -> Any:
    return getattr(importlib.import_module(f"{__name__}.api.verbs"), name)


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _VERBS:
        return _verb(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_VERBS})


sys.modules[__name__].__class__ = _Package

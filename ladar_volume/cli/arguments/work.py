"""The work of a verb, loaded when it begins: numba and SciPy take seconds that a refusal of what
the command line names need not wait for.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path

from ladar_volume.io.endings import CLOUD_ENDINGS, READ_ENDINGS, unknown_cloud
from ladar_volume.model.errors import BagError, InputError, LadarVolumeError

#: Arguments that name a file to read, by verb.
FILES = {
    "diff": ("transform", "transform_b"),
    "register": ("apply",),
    "calibrate": ("file",),
    "epochs": ("previous", "new", "transform"),
    "export": ("result",),
}
#: Arguments that name a point cloud or a mesh, by verb.
CLOUDS = {
    "volume": ("cloud", "cloud_b"),
    "tin": ("cloud",),
    "tiles": ("cloud",),
    "filter": ("cloud",),
    "body": ("source",),
    "diff": ("a", "b"),
    "register": ("a", "b"),
}
#: Arguments that name a recording, by verb.
RECORDINGS = {"replay": ("bag",), "up": ("play",), "calibrate": ("bag",)}


def work(module: str, function: str = "run") -> Callable[[argparse.Namespace], int]:
    """``function`` of ``module``, loaded once the files are there and the overrides are sound."""

    def run(arguments: argparse.Namespace) -> int:
        for error in refusals(arguments):
            raise error
        return int(getattr(importlib.import_module(module), function)(arguments))

    return run


def refusals(arguments: argparse.Namespace) -> Iterator[LadarVolumeError]:
    """What can be said of the command line without any work. Raises ConfigurationError for an
    override or its configuration file.
    """
    if arguments.verb == "filter":  # keys of a section of its own
        from ladar_volume.cli.inputs.filter_settings import settings

        settings(arguments)
    elif getattr(arguments, "set", None):
        from ladar_volume.io.config import read_config

        read_config(config_of(arguments), arguments.set)
    verb, given = arguments.verb, vars(arguments)
    clouds = [path for name in CLOUDS.get(verb, ()) if (path := given.get(name)) is not None]
    files = [path for path in clouds if of_known_kind(path)]
    for path in (*files, *(given.get(name) for name in FILES.get(verb, ()))):
        if path is not None and not path.exists():
            of_results = verb in ("epochs", "export") and not of_known_kind(path)
            hint = "; replay writes it" if of_results else ""
            yield InputError(f"{path}: no such file{hint}", reason="input_missing", value=str(path))
    for path in clouds:
        if path not in files:
            yield InputError(unknown_cloud(path), reason=f"{InputError.reason}_format")
    recordings = [given.get(name) for name in RECORDINGS.get(verb, ())]
    for path in (*recordings, *(given.get("more", []) if verb == "replay" else [])):
        if path is not None and not path.exists():
            yield BagError(f"{path}: no such recording", reason="bag_missing", value=str(path))


def of_known_kind(path: Path) -> bool:
    """Whether point clouds or meshes are read from files with this ending."""
    return path.suffix.lower() in (*CLOUD_ENDINGS, *READ_ENDINGS)


def config_of(arguments: argparse.Namespace) -> Path | None:
    """The configuration file that the work will read: the one given, else the recording's own."""
    given = vars(arguments)
    names = RECORDINGS.get(arguments.verb, ())
    recording = next((given[n] for n in names if given.get(n) is not None), None)
    config: Path | None = given.get("config")
    return config if recording is None else config_for(recording, config)


def config_for(recording: Path, config: Path | None) -> Path | None:
    """The given file, else the one in the recording's folder."""
    beside = recording / "config.yaml"
    return config if config is not None else beside if beside.is_file() else None

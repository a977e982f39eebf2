"""The verbs of the command line as functions. They take what the command line takes, by the names
of its options with ``_`` for ``-``, and compute with the same code: the same numbers.
"""

from __future__ import annotations

import argparse
import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

from ladar_volume.api.answers import FilterAnswer, SurveyAnswer, VolumeAnswer
from ladar_volume.cli.inputs.reading import Source, reading_of
from ladar_volume.cli.main import make_parser
from ladar_volume.io.pointfiles.cloud_files import PointFile, read_cloud
from ladar_volume.io.pointfiles.point_file import assemble
from ladar_volume.io.pointfiles.raw_table import RawTable
from ladar_volume.model.errors import ConfigurationError, InputError

if TYPE_CHECKING:
    from ladar_volume.cli.outputs.cloud_files_out import ExportableResult
    from ladar_volume.io.export.deliverable import Deliverable
    from ladar_volume.model.parameters import Parameters

#: Points: a file, what :func:`read` gave, or an array (n, 3), m.
Points: TypeAlias = "str | PathLike[str] | PointFile | npt.ArrayLike"
#: What an option may be.
Option: TypeAlias = "str | float | bool | Sequence[str] | Sequence[float] | None"
#: What an array is called in results.
ARRAY = Path("array")


def read(path: str | PathLike[str], **options: Option) -> PointFile:
    """A point cloud file in metres, with its attributes. Options: ``crs``, ``units``, ``classes``.

    Raises :class:`ladar_volume.model.errors.InputError` where units or CRS would have to be
    guessed, or the file cannot be read.
    """
    arguments = _arguments("volume", [ARRAY.name])
    _set(arguments, options, ("crs", "units", "classes"))
    return read_cloud(Path(path), reading=reading_of(arguments))


def volume(points: Points, base: float | Points | None = None, **options: Option) -> VolumeAnswer:
    """Cut, fill and net volume of a surface, as ``ladar_volume volume``.

    base : a level (m), "ground", "plane" (with ``plane=(c0, c1, c2)``), or other points, below
    which nothing counts · options : those of the command line, as ``sigma=0.02``; with
    ``output="folder"`` and ``formats="tif,landxml"`` files are written, with ``report="x.html"`` a
    report of points that come from files
    """
    from ladar_volume.cli.outputs.cloud_files_out import wanted_files, write_files
    from ladar_volume.cli.volume import report_of, result_of, task_of

    second = _second(base, options)
    given = [points] if second is None else [points, second]
    arguments = _arguments("volume", [ARRAY.name] * len(given))
    _set(arguments, options)
    arguments.cloud, arguments.cloud_b = _name(points), None if second is None else _name(second)
    if arguments.output is not None:
        arguments.output = Path(arguments.output)
    if arguments.report is not None:
        arguments.report = Path(arguments.report)
        if ARRAY in (arguments.cloud, arguments.cloud_b):
            raise ConfigurationError("a report names its input by digests of files: give paths")
    task, wanted = task_of(arguments), wanted_files(arguments)
    sources = [_source(each, arguments, at == 1) for at, each in enumerate(given)]
    found = result_of(task, sources, lambda words: None)
    if wanted is not None:
        write_files(arguments, wanted, sources, found)
    if arguments.report is not None:
        report_of(arguments, found)
    facts = found.facts
    return VolumeAnswer(
        facts=facts,
        interval_m3=tuple(facts["interval_m3"]),
        tin=found.surfaces[0].representation.tin,
        make_deliverable=lambda: _map_of(arguments, sources, found),
        **{name: facts[name] for name in ("net_m3", "sigma_m3", "confidence", "cut_m3", "fill_m3")},
        **{name: facts[name] for name in ("area_m2", "base", "sigma_holds")},
    )


def _map_of(
    arguments: argparse.Namespace, sources: Sequence[Source], found: ExportableResult
) -> Deliverable:
    """What tables and rasters of a result hold. Raises :class:`ConfigurationError` for a surface
    over another plane than the map's.
    """
    from ladar_volume.cli.outputs.cloud_files_out import deliverable
    from ladar_volume.io.export.export_set import ExportRequest
    from ladar_volume.io.export.output_system import system_of_cloud

    if arguments.frame != "level":
        raise ConfigurationError("tables and rasters are maps: they go with frame='level'")
    system = system_of_cloud(sources[0].cloud.coordinates, False)
    return deliverable(ExportRequest(("tif",)), sources, found, system)


def filter(points: Points, **options: Option) -> FilterAnswer:
    """Outliers out, noise down, edges kept, as ``ladar_volume filter``. Options are those of the
    command line, as ``radius=0.2`` or ``preset="thesis"``.
    """
    from ladar_volume.cli.filter import filter_with_options

    arguments = _arguments("filter", [ARRAY.name, "-o", ARRAY.name])
    _set(arguments, options)
    arguments.cloud = _name(points)
    cloud = _cloud(points, arguments)
    found, facts = filter_with_options(arguments, cloud)
    return FilterAnswer(
        facts=facts,
        r_m=found.r,
        normal=found.normal,
        sigma_m=found.sigma,
        index=found.index,
        outliers=found.outliers,
    )


def replay(
    bag: str | PathLike[str] | Sequence[str | PathLike[str]],
    config: str | PathLike[str] | None = None,
    overrides: Mapping[str, object] | None = None,
    start_s: float = 0.0,
    duration_s: float = math.inf,
) -> SurveyAnswer:
    """The volume of a recorded survey, as ``ladar_volume replay``; nothing is written.

    bag : a recording, or several of one survey · config : parameter file; else ``config.yaml`` in
    the first recording's folder, if any · overrides : parameters by ``section.key``
    """
    from ladar_volume.io.bags import wanted_topics
    from ladar_volume.io.drivers.recording_series import open_recordings
    from ladar_volume.replay import Replay

    paths = [Path(p) for p in ([bag] if isinstance(bag, str | PathLike) else bag)]
    parameters = _parameters(paths[0], config, overrides or {})
    with open_recordings(paths) as recording:
        survey = Replay(
            recording,
            parameters,
            recording.roles(wanted_topics({}, parameters)),
            start_s,
            duration_s,
        )
        estimate = survey.run()
        facts = survey.result(estimate)
    v = estimate.volume
    return SurveyAnswer(
        facts=facts,
        volume_m3=v.volume_m3,
        sigma_m3=v.sigma_m3,
        interval_m3=v.interval_m3,
        confidence=v.confidence,
        area_m2=v.area_m2,
        base=v.base,
        budget_m3={name: math.sqrt(max(line, 0.0)) for name, line in v.budget_m6.items()},
        estimate=estimate,
    )


def _parameters(
    bag: Path, config: str | PathLike[str] | None, overrides: Mapping[str, object]
) -> Parameters:
    """Parameters as ``replay`` reads them."""
    from ladar_volume.cli.arguments.work import config_for
    from ladar_volume.io.config import read_config

    file = config_for(bag, None if config is None else Path(config))
    return read_config(file, [f"{key}={value}" for key, value in overrides.items()])


def _second(base: float | Points | None, options: dict[str, Option]) -> Points | None:
    """The points that are the base; where it is a level or has a name it becomes an option. Raises
    :class:`ConfigurationError` for a name that there is not.
    """
    if base is None or isinstance(base, PointFile | PathLike):
        return base
    if isinstance(base, int | float | np.number) and not isinstance(base, bool):
        options["level"] = float(base)
        return None
    if not isinstance(base, str) or Path(base).suffix:
        return base
    if base not in _bases():
        near = difflib.get_close_matches(base, _bases(), 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        words = ", ".join(map(repr, _bases()))
        raise ConfigurationError(
            f"base {base!r}: a level in m, {words}, points or a file{hint}", value=base
        )
    options["base"] = base
    return None


def _bases() -> tuple[str, ...]:
    from ladar_volume.cli.arguments.volume import BASES

    return tuple(BASES)


def _arguments(verb: str, words: list[str]) -> argparse.Namespace:
    """The options of a verb as the command line has them where none is given."""
    return make_parser(verb).parse_args([verb, *words])


def _set(
    arguments: argparse.Namespace, options: Mapping[str, Option], allowed: Sequence[str] = ()
) -> None:
    """Set options by name. Raises :class:`ConfigurationError` for one that there is not, with the
    nearest one that there is, and for text where a number belongs.
    """
    numeric = _numeric_options(arguments.verb)
    names = list(allowed) or sorted(set(vars(arguments)) - {"verb", "run", "json", "cloud"})
    for name, value in options.items():
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            hint = f"; did you mean {near[0]!r}?" if near else f" (there are {', '.join(names)})"
            raise ConfigurationError(f"{name!r} is no option{hint}", value=name)
        if name in numeric and not _is_numeric(value):
            raise ConfigurationError(
                f"{name}={value!r} is no number: give {name}=0.1, not its text", value=value
            )
        setattr(arguments, name, value)


def _numeric_options(verb: str) -> set[str]:
    """Names of a verb's options whose values are numbers."""
    actions = make_parser(verb)._actions
    (verbs,) = (a for a in actions if isinstance(a, argparse._SubParsersAction))
    kinds = {a.dest: getattr(a.type, "__name__", "") for a in verbs.choices[verb]._actions}
    return {name for name, kind in kinds.items() if kind in ("number", "float", "int")}


def _is_numeric(value: Option) -> bool:
    """Whether a value is a number, several of them, or the default."""
    if isinstance(value, Iterable) and not isinstance(value, str | bytes):
        return all(_is_numeric(each) for each in value)
    return value is None or (isinstance(value, Real) and not isinstance(value, bool))


def _name(points: Points) -> Path:
    return Path(points) if isinstance(points, str | PathLike) else ARRAY


def _source(points: Points, arguments: argparse.Namespace, second: bool) -> Source:
    """Points as the verb reads them: faces of a mesh file count."""
    from ladar_volume.cli.surface_options import read_surface

    if isinstance(points, str | PathLike):
        return read_surface(Path(points), arguments, second)
    return Source(ARRAY, _cloud(points, arguments))


def _cloud(points: Points, arguments: argparse.Namespace) -> PointFile:
    """Points in metres. Raises :class:`InputError` for an array that is no (n, 3)."""
    if isinstance(points, PointFile):
        return points
    if isinstance(points, str | PathLike):
        return read_cloud(Path(points), reading=reading_of(arguments))
    r = np.asarray(points)
    if r.ndim != 2 or r.shape[1] != 3 or r.dtype.kind not in "fiu":
        raise InputError(
            f"points of shape {r.shape} and type {r.dtype}: give numbers (n, 3) in m",
            reason="input_format",
            value=list(r.shape),
        )
    columns = {axis: r[:, at] for at, axis in enumerate("xyz")}
    return assemble(RawTable(columns), True, reading_of(arguments))

"""How the verbs read point clouds, and what they say of the coordinates; the options are declared
in cli/arguments/reading.py.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.table import Table

from ladar_volume.io.meshfiles.mesh_files import MeshFile, in_metres
from ladar_volume.io.pointfiles.cloud_files import PointFile, Reading, read_cloud
from ladar_volume.io.pointfiles.crs import parts_of, reading_units, same_crs
from ladar_volume.io.pointfiles.raw_table import WAVES
from ladar_volume.model.errors import ConfigurationError, InputError
from ladar_volume.model.verdict import Doubt


@dataclass(frozen=True)
class Source:
    """A file as read: its name and what is in it; of a mesh whose faces count these too, its
    vertices being the cloud.
    """

    path: Path
    cloud: PointFile
    mesh: MeshFile | None = None


def clouds_of(sources: Sequence[Source]) -> list[PointFile]:
    """The point clouds among the sources, and meshes that name their system."""
    return [
        source.cloud
        for source in sources
        if source.mesh is None or source.cloud.coordinates.crs is not None
    ]


def reading_of(arguments: argparse.Namespace) -> Reading:
    """What the options say. Raises :class:`ConfigurationError` for words that are none."""
    across, up = (None, None) if arguments.units is None else reading_units(arguments.units)
    text, classes = arguments.classes, None
    if text is not None:
        words = [word.strip() for word in text.split(",")]
        if text.strip() != "all" and not all(w.isdigit() and int(w) < 256 for w in words):
            raise ConfigurationError(
                f"--classes {text}: whole numbers from 0 to 255 with commas between, or all",
                value=text,
            )
        classes = () if text.strip() == "all" else tuple(int(w) for w in words)
    return Reading(arguments.crs, across, up, classes)


def read_source(path: Path, arguments: argparse.Namespace) -> Source:
    """Read a cloud file with its columns, in metres, as the options say."""
    return Source(path, read_cloud(path, reading=reading_of(arguments)))


def mesh_in_metres(mesh: MeshFile, arguments: argparse.Namespace) -> MeshFile:
    """A mesh file in m, by what its head says or, where it says nothing, the options. Raises
    :class:`ConfigurationError` for options that a mesh has no use for or contradicts.
    """
    reading = reading_of(arguments)
    if reading.classes is not None:
        raise ConfigurationError("--classes is for point clouds; a mesh takes --crs and --units")
    if mesh.at is not None and (reading.crs or reading.across) is not None:
        option = "--units" if reading.across is not None else "--crs"
        if mesh.unit or option == "--crs":
            raise ConfigurationError(
                f"{option}: a LandXML says itself what it is in ({mesh.at.words})", value=option
            )
        return _land_units(mesh, reading)
    return in_metres(mesh, reading)


def _land_units(mesh: MeshFile, reading: Reading) -> MeshFile:
    """A LandXML that names no units in those of the option."""
    doubts = tuple(d for d in mesh.doubts if d.name != "mesh_units")
    out = in_metres(dataclasses.replace(mesh, at=None, doubts=doubts), reading)
    assert out.at is not None
    across, up = out.at.factor
    lines = tuple(line * [across, across, up] for line in mesh.breaklines)
    return dataclasses.replace(out, breaklines=lines)


def cloud_facts_of(cloud: PointFile) -> dict[str, Any]:
    """What the JSON says of how a cloud was read."""
    steps = None if cloud.resolution_m is None else cloud.resolution_m.tolist()
    return {
        "coordinates": cloud.coordinates.as_dict(),
        "left_out": dict(cloud.left_out),
        "resolution_m": steps,
    }


def reading_doubts(clouds: Sequence[PointFile]) -> tuple[Doubt, ...]:
    """What is doubtful about the coordinates of all clouds, and about laying one on the other.
    Raises :class:`InputError` (input_crs) for clouds of unlike systems.
    """
    out = [doubt for cloud in clouds for doubt in cloud.doubts]
    for other in clouds[1:]:
        out += _pair_doubts(clouds[0], other)
    return tuple(out)


def _pair_doubts(a: PointFile, b: PointFile) -> list[Doubt]:
    one, two = a.coordinates, b.coordinates
    if one.crs is None or two.crs is None:
        if one.crs is None and two.crs is None:
            return []
        name = (one.crs or two.crs).name  # type: ignore[union-attr]
        words = (
            f"1 of 2 clouds names no CRS: it is taken to be in {name} as well; say so with --crs"
        )
        return [Doubt("crs_of_one", words, 1.0)]
    for part, other in zip(parts_of(one.crs), parts_of(two.crs), strict=True):
        if part is not None and other is not None and not same_crs(part, other):
            raise InputError(
                f"the clouds lie in unlike systems, {part.name} and {other.name}: transform one "
                "of them first",
                reason="input_crs",
                value=[part.name, other.name],
            )
    if one.file_coordinates.heights != two.file_coordinates.heights:
        seen = " and ".join(
            at.file_coordinates.heights or "no vertical datum named" for at in (one, two)
        )
        words = f"heights of 2 clouds, {seen}: their difference is in V; name it with --crs"
        return [Doubt("vertical_datum", words, 2.0)]
    return []


def left_out_words(cloud: PointFile) -> str:
    """What of a file was left out, to end a sentence with; empty for nothing."""
    count = sum(cloud.left_out.values())
    why = ", ".join(f"{reason} {n}" for reason, n in cloud.left_out.items())
    return f"; {count} of {count + len(cloud)} points were not read: {why}" if count else ""


def add_reading_rows(table: Table, facts: Mapping[str, Any], words: str = "") -> None:
    """Rows that say how a cloud was read; of ``facts`` as from :func:`cloud_facts_of`."""
    at = facts["coordinates"]
    units, up = at["units_read"], at["units_read_z"]
    line = at["code"] or at["crs"] or "no CRS named"
    line += f"; units: {units if units == up else f'{units}, heights {up}'}"
    line += " → m" if (units, up) != ("metre", "metre") else ""
    line += " (assumed)" if at["units_from"] == "assumed" else ""
    line += f"; heights above {at['heights']}" if at["heights"] else ""
    table.add_row(words or "coordinates", line.replace("[", r"\["))
    if at["grid_scale"] is not None:
        part = 100.0 * (at["volume_on_ground_factor"] - 1.0)
        table.add_row(
            "", f"map scale {at['grid_scale']:.6f}: volumes on the ground are {part:+.3f} % larger"
        )
    for reason, count in facts["left_out"].items():
        table.add_row("  left out", f"{count:,} {reason}")


def carried_columns(
    cloud: PointFile, output: Path, taken: Iterable[str]
) -> tuple[dict[str, npt.NDArray[Any]], list[str]]:
    """Columns of a cloud that another file can hold beside those already ``taken``, by names it can
    have, and the names of the others.
    """
    ending = output.suffix.lower()
    taken, out = set(taken), dict[str, npt.NDArray[Any]]()
    lost: list[str] = []
    for name, column in cloud.columns.items():
        new = name if ending in (".las", ".laz") else re.sub(r"\W", "_", name)
        new = new if new[:1].isalpha() or new[:1] == "_" else f"c_{new}"
        words = column.dtype.kind == "U" and (
            ending not in (".csv", ".xyz", ".txt", ".asc", ".npy")
            or any(set(v) & set(' ,;#"\n\t') or not v for v in np.unique(column).tolist())
        )
        if new.lower() in {t.lower() for t in taken} and name in taken:
            continue  # made anew
        if ending == ".laz" and cloud.las is not None and name in WAVES:
            words = True  # not kept by the compression
        if (
            words
            or column.dtype.kind not in "fiuU"
            or new in taken
            or new in out
            or (ending in (".las", ".laz") and len(new.encode()) > 32)
        ):
            lost.append(name)
            continue
        out[new] = column
    return out, lost

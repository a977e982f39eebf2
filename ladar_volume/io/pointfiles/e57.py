"""E57 (ASTM E2807), read by libE57 through pye57: the scans of a file in its common frame, m."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from ladar_volume.georeference.sample_admission import unit_quaternion
from ladar_volume.io.pointfiles.crs import Coordinates, coordinates_of, crs_of_text
from ladar_volume.io.pointfiles.raw_table import Columns, RawTable
from ladar_volume.io.pointfiles.units import METRE
from ladar_volume.math.se3 import matrix_from_quaternion
from ladar_volume.model.errors import AttitudeError, CloudError, InputError
from ladar_volume.model.records import F64

#: A node of libE57's tree, or the file itself; pye57 has no types.
Node: TypeAlias = Any
#: What a damaged tree raises: the last two are nodes of other kinds than the standard says.
DAMAGED = (RuntimeError, KeyError, UnicodeDecodeError, AttributeError, TypeError)
#: Points that are read at a time: a damaged header must not ask for all memory at once.
CHUNK = 1_000_000
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
#: Other fields that are read, and what they are called here.
MORE = {
    "intensity": "intensity",
    "colorRed": "red",
    "colorGreen": "green",
    "colorBlue": "blue",
    "rowIndex": "row",
    "columnIndex": "column",
    "returnIndex": "return_index",
    "returnCount": "return_count",
    "timeStamp": "time_stamp",
}
#: Fields that say a point is no return, or a direction alone.
INVALID = ("cartesianInvalidState", "sphericalInvalidState")
#: Columns of whole numbers.
WHOLE = {"red", "green", "blue", "row", "column", "return_index", "return_count"}


def read_e57(path: Path, columns: bool = True) -> RawTable:
    """x, y, z, m, of all scans, each turned and shifted by its pose; points without a return are
    NaN. Where ``columns``, the attributes that all scans have, and ``scan``, their number from 0.

    Raises :class:`CloudError` (cloud_header, cloud_values, cloud_short, cloud_empty, cloud_fields)
    and :class:`InputError` (input_crs), and ModuleNotFoundError without pye57.
    """
    from pye57 import libe57

    try:
        # not pye57's own class: it may delete a file that it cannot open
        image = libe57.ImageFile(str(path), "r")
    except (libe57.E57Exception, RuntimeError) as error:
        raise CloudError(
            f"no E57 file, damaged or cut short: {error}", reason="cloud_header"
        ) from error
    try:
        root = image.root()
        said = stated_coordinates(root)
        held = child(root, "data3D") if root.isDefined("data3D") else ()
        scans = [scan_columns(image, held[k], columns) for k in range(len(held))]
    except (libe57.E57Exception, *DAMAGED) as error:
        raise CloudError(
            f"cannot be decoded, damaged or cut short: {error}", reason="cloud_values"
        ) from error
    finally:
        image.close()
    if not scans:
        raise CloudError("there is no scan in it", reason="cloud_empty")
    names = [name for name in scans[0] if all(name in scan for scan in scans)]
    out = {name: np.concatenate([scan[name] for scan in scans]) for name in names}
    if columns and len(scans) > 1:
        out["scan"] = np.repeat(np.arange(len(scans)), [len(scan["x"]) for scan in scans])
    return RawTable(out, said)


def child(node: Node, name: str) -> Node:
    """A part of a node, with the methods of its kind."""
    from pye57.utils import get_node

    return get_node(node, name)


def stated_coordinates(root: Node) -> Coordinates:
    """The system that the file names; without one it is in metres, as every E57."""
    named = (
        child(root, "coordinateMetadata").value() if root.isDefined("coordinateMetadata") else ""
    )
    if not named.strip():
        return Coordinates(across=METRE, up=METRE)
    said = coordinates_of(crs_of_text(named, "the E57"), "header")
    if said.degrees or said.across is None or not said.across.equals(METRE):
        raise InputError(
            f"the E57 names {said.name}, and holds metres, as every E57: export it in a projected "
            "system in metres",
            reason="input_crs",
            value=said.name,
        )
    return said


def scan_columns(image: Node, scan: Node, columns: bool) -> Columns:
    """The columns (n,) of one scan, x, y, z in the frame of the file."""
    from pye57.libe57 import StructureNode

    points = child(scan, "points")
    prototype = StructureNode(points.prototype())
    own = next((n for n in (CARTESIAN, SPHERICAL) if all(map(prototype.isDefined, n))), None)
    if own is None:
        raise CloudError("a scan without x, y, z or ranges", reason="cloud_fields")
    wanted = [f for f in (*own, *INVALID, *(MORE if columns else ())) if prototype.isDefined(f)]
    found = read_fields(image, points, wanted)
    r = np.column_stack([found.pop(name) for name in own])
    if own == SPHERICAL:
        r = from_spherical(r)
    for name in INVALID:
        if name in found:
            r[found.pop(name) != 0.0] = np.nan
    r = apply_pose(scan, r)
    out: Columns = {axis: np.ascontiguousarray(r[:, k]) for k, axis in enumerate("xyz")}
    for name, values in found.items():
        word = MORE[name]
        whole = word in WHOLE and bool((np.abs(values) < 2**31).all())
        out[word] = values.astype(np.int32) if whole else values
    return out


def read_fields(image: Node, points: Node, names: list[str]) -> dict[str, F64]:
    """Fields of the points of a scan, (n,) each. Raises :class:`CloudError` (cloud_short)."""
    from pye57 import libe57

    announced = int(points.childCount())
    size = max(1, min(CHUNK, announced))
    held = {name: np.empty(size) for name in names}
    buffers = libe57.VectorSourceDestBuffer()
    for name, values in held.items():
        buffers.append(libe57.SourceDestBuffer(image, name, values, size, True, True))
    parts: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in names}
    reader = points.reader(buffers)
    while count := reader.read():
        for name, values in held.items():
            parts[name].append(values[:count].copy())
    reader.close()
    out = {name: np.concatenate(p) if p else np.zeros(0) for name, p in parts.items()}
    if len(out[names[0]]) != announced:
        raise CloudError(
            f"{len(out[names[0]])} points where {announced} are announced",
            reason="cloud_short",
            value=announced,
        )
    return out


def from_spherical(polar: F64) -> F64:
    """Range (m), azimuth and elevation (rad), (n, 3), as x, y, z (ASTM E2807)."""
    distance, azimuth, elevation = polar.T
    flat = distance * np.cos(elevation)
    out: F64 = np.column_stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)]
    )
    return out


def values_of(node: Node, names: str) -> F64:
    """Numbers of a node by name."""
    return np.array([float(child(node, name).value()) for name in names])


def apply_pose(scan: Node, r: F64) -> F64:
    """Points (n, 3) of a scan in the frame of the file: turned by its quaternion, then shifted."""
    if not scan.isDefined("pose"):
        return r
    pose = child(scan, "pose")
    if pose.isDefined("rotation"):
        try:
            q = unit_quaternion(values_of(child(pose, "rotation"), "xyzw"), "a pose")
        except AttitudeError as error:
            raise CloudError(str(error), reason="cloud_values") from error
        r = r @ matrix_from_quaternion(q).T
    if pose.isDefined("translation"):
        r = r + values_of(child(pose, "translation"), "xyz")
    return r

"""LAS, LAZ and COPC written by laspy: every column in its own dimension, the CRS, and what the
header of the file that the points come from says.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import laspy
import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.copc_write import write_copc
from ladar_volume.io.pointfiles.ply import narrow
from ladar_volume.io.pointfiles.raw_table import WAVES, Columns
from ladar_volume.model.errors import OutputError
from ladar_volume.model.records import F64

if TYPE_CHECKING:
    from pyproj import CRS

#: Finest step of the stored integers, m: rounding of 0.05 mm is far below any sensor's noise.
SCALE_M = 1e-4
#: Dimensions that ask for a richer point format than 6.
COLOURS, INFRARED = {"red", "green", "blue"}, {"nir"}
#: Point formats with wave packets, and the same ones without.
WITHOUT_WAVES = {4: 1, 5: 3, 9: 6, 10: 8}
#: What COPC has for the older ones.
MODERN = {0: 6, 1: 6, 2: 7, 3: 7}
#: Degrees of a step of the scan angle in formats 6 to 10; older ones have whole degrees.
ANGLE_DEG = 0.006
#: Records that laspy writes itself, and those that hold for the old file alone.
OWN_RECORDS = {("laszip encoded", 22204), ("LASF_Spec", 4), ("copc", 1), ("copc", 1000)}
PROJECTION = "LASF_Projection"


def write_las(
    path: Path,
    columns: Columns,
    comments: list[str],
    template: laspy.LasHeader | None = None,
    crs: CRS | None = None,
    same_system: bool = False,
    version: str | None = None,
) -> None:
    """Write points; LAZ by the file's ending, and COPC by ``.copc.laz``.

    A column that the point format has a place for goes there where its values fit, else into extra
    bytes. ``template`` gives point format, version, GPS time's kind and records; where
    ``same_system``, its numbers are those that are written, and it gives offsets, and without a
    ``crs`` its own. A ``crs`` is written as WKT. ``version`` is the least that is written.
    Coordinates are integers of 0.1 mm, or a finer whole part of ``template``'s step (coarser only
    where the cloud is wider than 400 km). ``comments`` become a record of user "ladar_volume". COPC
    has point formats 6 to 8, a WKT or no system, and an order of its own. Raises OSError and
    :class:`OutputError`.
    """
    copc = is_copc(path)
    if path.suffix.lower() == ".laz" and template is not None and set(columns) & WAVES:
        raise OutputError(
            "the compression of wave packets loses places in files of several channels: write .las",
            value=sorted(set(columns) & WAVES),
        )
    columns = _columns_of(columns, copc)
    r = np.column_stack([columns.pop(axis) for axis in "xyz"])
    header = _header(template, columns, crs, same_system, copc)
    if version is not None:
        header.version = max(header.version, laspy.header.Version.from_str(version))
    _set_scales(header, r, template if same_system else None)
    own, extra = _split_columns(header, template, columns)
    _add_extra(header, template, extra)
    if comments:
        text = json.dumps(comments).encode()
        header.vlrs.append(laspy.VLR("ladar_volume", 1, "names of the codes", text))
    points = _record(header, r, {**own, **extra})
    write_copc(path, header, points) if copc else laspy.LasData(header, points).write(str(path))


def _columns_of(columns: Columns, copc: bool) -> Columns:
    """The columns in the smallest types that hold them, by the names that the kind of file has."""
    columns = {name: narrow(c) for name, c in columns.items()}
    if copc and "scan_angle_rank" in columns:
        rank = np.asarray(columns.pop("scan_angle_rank"), np.float64)
        columns["scan_angle"] = np.round(rank / ANGLE_DEG).astype(np.int16)
    return columns


def _record(header: laspy.LasHeader, r: F64, columns: Columns) -> laspy.ScaleAwarePointRecord:
    points = laspy.ScaleAwarePointRecord.zeros(len(r), header=header)
    points.x, points.y, points.z = r.T
    for name, c in columns.items():
        points[name] = c
    return points


def is_copc(path: Path) -> bool:
    """Whether a file of this name is cloud-optimised."""
    return path.name.lower().endswith(".copc.laz")


def _header(
    template: laspy.LasHeader | None,
    columns: Columns,
    crs: CRS | None,
    same_system: bool,
    copc: bool,
) -> laspy.LasHeader:
    if template is None:
        names = set(columns)
        kind = 8 if INFRARED <= names and names >= COLOURS else 7 if names >= COLOURS else 6
        header = laspy.LasHeader(point_format=kind, version="1.4")
    else:
        # WKT has its place in 1.4, which holds every point format
        version = "1.4" if crs is not None or copc else str(template.version)
        own_crs = same_system and crs is None and (template.global_encoding.wkt or not copc)
        kind = template.point_format.id
        kind = kind if set(columns) & WAVES else WITHOUT_WAVES.get(kind, kind)
        kind = MODERN.get(kind, kind) if copc else kind
        header = laspy.LasHeader(point_format=kind, version=version)
        header.global_encoding.gps_time_type = template.global_encoding.gps_time_type
        header.file_source_id, header.uuid = template.file_source_id, template.uuid
        header.system_identifier = template.system_identifier
        header.creation_date = template.creation_date
        kept = [
            v
            for v in [*template.vlrs, *(template.evlrs or [])]
            if (v.user_id, v.record_id) not in OWN_RECORDS
            and (own_crs or v.user_id != PROJECTION)
            and v.user_id != "ladar_volume"
            and len(v.record_data_bytes()) < 2**16
        ]
        header.vlrs.extend(kept)
        if own_crs:
            header.global_encoding.wkt = template.global_encoding.wkt
    if crs is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt_of(crs)))
        header.global_encoding.wkt = True
    header.global_encoding.wkt |= copc  # point formats 6 to 10 have no other words for a system
    return header


def wkt_of(crs: CRS) -> str:
    """WKT in the old dialect that LAS asks for; in the new one where the old has no words."""
    from pyproj.exceptions import CRSError

    try:
        return str(crs.to_wkt("WKT1_GDAL"))
    except CRSError:
        return str(crs.to_wkt())


def _set_scales(header: laspy.LasHeader, r: F64, template: laspy.LasHeader | None) -> None:
    low, high = (r.min(axis=0), r.max(axis=0)) if len(r) else (np.zeros(3), np.zeros(3))
    if template is not None:
        scales, offsets = np.abs(np.array(template.scales)), np.array(template.offsets)
        fine = scales / np.ceil(scales / SCALE_M * (1.0 - 1e-9))
        if (np.abs(np.array([low, high]) - offsets) <= 2.0**31 * 0.999 * fine).all():
            header.scales, header.offsets = fine, offsets
            return
    header.offsets = np.round(0.5 * (low + high))
    header.scales = np.maximum(SCALE_M, np.ceil((high - low) / 4.0e9 / SCALE_M) * SCALE_M)


def _split_columns(
    header: laspy.LasHeader, template: laspy.LasHeader | None, columns: Columns
) -> tuple[Columns, Columns]:
    """Columns that the point format has a place for, and those for extra bytes."""
    own: Columns = {}
    extra: Columns = {}
    standard = set(header.point_format.standard_dimension_names) - {"X", "Y", "Z"}
    for name, c in columns.items():
        if name not in standard:
            extra[name] = c
        elif (cast := _fits(header, name, c)) is not None:
            own[name] = cast
        else:
            extra[f"{name}_value"] = c
    return own, _join_vectors(template, extra)


def _fits(header: laspy.LasHeader, name: str, column: npt.NDArray[Any]) -> npt.NDArray[Any] | None:
    """The column as the dimension holds it, where nothing is lost; else None."""
    place = header.point_format.dimension_by_name(name)
    if place.kind == laspy.DimensionKind.FloatingPoint:
        return column
    if column.dtype.kind == "f" and not bool((column == np.round(column)).all()):
        return None
    if len(column) and not (float(column.min()) >= place.min and float(column.max()) <= place.max):
        return None
    return column.astype(np.int64)


def _join_vectors(template: laspy.LasHeader | None, extra: Columns) -> Columns:
    """Vectors among the extra bytes of ``template``, whose parts are columns ``name_0``,
    ``name_1``.
    """
    for place in [] if template is None else template.point_format.extra_dimensions:
        parts = [f"{place.name}_{k}" for k in range(place.num_elements)]
        if place.num_elements > 1 and set(parts) <= set(extra):
            extra[place.name] = np.column_stack([extra.pop(part) for part in parts])
    return extra


def _add_extra(header: laspy.LasHeader, template: laspy.LasHeader | None, extra: Columns) -> None:
    known: Mapping[str, Any] = (
        {} if template is None else {d.name: d for d in template.point_format.extra_dimensions}
    )
    if any(len(name.encode()) > 32 for name in extra):
        raise OutputError(
            "a column's name is longer than the 32 bytes LAS has for it", value=list(extra)
        )
    made = []
    for name, c in extra.items():
        old = known.get(name)
        many = c.shape[1] if c.ndim == 2 else 1
        if old is not None and old.is_scaled and old.num_elements == many:
            made.append(
                laspy.ExtraBytesParams(
                    name,
                    old.type_str(),
                    description=old.description,
                    offsets=old.offsets,
                    scales=old.scales,
                    no_data=old.no_data,
                )
            )
            continue
        code = c.dtype.str[1:] if many == 1 else f"{many}{c.dtype.str[1:]}"
        made.append(laspy.ExtraBytesParams(name, code, "" if old is None else old.description))
    if made:
        header.add_extra_dims(made)

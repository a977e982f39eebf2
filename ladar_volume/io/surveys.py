"""A survey as a file: result.mcap, which Foxglove opens as tables and from which the volume to a
later survey is computed.

Beside the tables a person looks at it holds what the nodes send each other, ``points_filtered`` and
``patches``, and in ``navigation`` the platform's covariance and mean pose per time bin: the surface
comes back bit by bit, its covariances to 1e-7.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.reader import make_reader

from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.io import cdr, message_tables, results
from ladar_volume.io.atomic_write import atomic_file
from ladar_volume.io.bags import TYPESTORE, BagReader
from ladar_volume.io.mcap_log import McapLog
from ladar_volume.io.tables import NUMBERS, decode, encode
from ladar_volume.model.errors import InputError, short_repr
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Datum, Estimate, FilterUpdate, select
from ladar_volume.registration.transform import Transform
from ladar_volume.uncertainty.epoch_budget import Epoch
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.packing import unpack_patches

#: Name of the file in a results folder, and of its metadata record.
FILE, RECORD = "result.mcap", "ladar_volume"
#: Type of the base as a pose.
GROUND_PLANE = "geometry_msgs/msg/PoseWithCovarianceStamped"
#: Rows of a table in one message, and triangles of a mesh in one, at most.
MOST_ROWS, MOST_TRIANGLES = 1 << 18, 2_000_000
#: Tables that hold the survey itself.
SURVEY = ("points_filtered", "patches", "navigation")


@dataclass(frozen=True)
class SavedSurvey:
    """path : of result.mcap · parameters : of the survey · navigation : the platform's covariance
    and mean pose by time bin · updates : the filtered surface, as the filter gave it · datum :
    origin of its map frame, None where it is not known · result : as in result.json
    """

    path: Path
    parameters: Parameters
    navigation: NavigationBins
    updates: tuple[FilterUpdate, ...]
    datum: Datum | None
    result: Mapping[str, Any]


def navigation_columns(bins: NavigationBins) -> message_tables.Columns:
    """``navigation``: per time bin its index, number of platform states, sums of C_nav (36), of
    position and R_map_body (12), and of fixes (2).
    """
    index, count, C, pose = bins.sums()
    return {
        "bin": index.astype(np.float64),
        "states": count.astype(np.uint32),
        "C_nav": C.reshape(-1, 36),
        "pose": pose.reshape(-1, 12),
        "fixes": bins.fix_sums,
    }


def survey_tables(epoch: Epoch) -> Iterator[tuple[str, message_tables.Columns]]:
    """Topics and columns of everything a survey is compared by, large ones in several messages."""
    points, patches = epoch.sources.points, epoch.sources.patches
    for first in range(0, len(patches), message_tables.PART):
        last = min(first + message_tables.PART, len(patches))
        mine = unpack_patches(patches, first, last)
        at = slice(*np.searchsorted(points.patch, [mine.key[0], mine.key[-1] + 1]))
        part = FilterUpdate(
            epoch.t_ns, np.zeros(0, np.int64), select(points, at), mine, last == len(patches)
        )
        yield "points_filtered", message_tables.filtered_columns(part.points)
        yield "patches", message_tables.patch_columns(part)
    yield "navigation", navigation_columns(epoch.sources.navigation)


def _table_message(columns: dict[str, npt.NDArray[Any]], t_ns: int) -> object:
    """Columns (n,) as a PointCloud2 of the map."""
    types, table = TYPESTORE.types, encode(columns)
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
    fields = [
        types["sensor_msgs/msg/PointField"](
            name=c.name, offset=c.offset, datatype=NUMBERS[c.code], count=c.count
        )
        for c in table.columns
    ]
    return types["sensor_msgs/msg/PointCloud2"](
        header=header,
        height=1,
        width=table.rows,
        fields=fields,
        is_bigendian=False,
        point_step=table.row_bytes,
        row_step=table.row_bytes * table.rows,
        data=table.data,
        is_dense=True,
    )


def write_survey(path: Path, estimate: Estimate, epoch: Epoch, result: Mapping[str, Any]) -> None:
    """The tables of volumes and ground surfaces, the surface (``tin`` coloured by height, ``mesh``
    whole, its vertices with sigma), the ground plane, the survey and the whole result as MCAP. A
    mesh of more than :data:`MOST_TRIANGLES` is left out. Raises OutputError.
    """
    t_ns = estimate.volume.t_ns
    vertices = estimate.tin.vertices
    tables = [("volumes", message_tables.volume_columns(list(estimate.bodies)))]
    every = dict(zip("xyz", vertices.T, strict=True)) | {"sigma_z": epoch.sigma_z(estimate.tin)}
    for first in range(0, len(vertices), MOST_ROWS):
        rows = {name: column[first : first + MOST_ROWS] for name, column in every.items()}
        tables.append(("tin_vertices", rows))
    if estimate.grounds:
        tables.append(("grounds", message_tables.ground_columns(estimate.grounds)))
    with atomic_file(path) as part, McapLog(Parameters().logger, part) as log:
        whole = np.count_nonzero(estimate.tin.relevant) <= MOST_TRIANGLES
        facts = {"result": results.json_text(result)}
        log.metadata(RECORD, facts if whole else facts | {"mesh": "too large: see mesh.ply"})
        for topic, columns in itertools.chain(tables, survey_tables(epoch)):
            log.write_message(topic, _table_message(columns, t_ns), t_ns)
        marker = cdr.tin_marker(estimate, vertices[:, 2], "map")
        log.write("tin", "visualization_msgs/msg/Marker", marker, t_ns)
        if whole:
            log.write("mesh", "shape_msgs/msg/Mesh", cdr.mesh(estimate), t_ns)
        log.write("ground_plane", GROUND_PLANE, cdr.ground_plane(estimate, "map"), t_ns)


def _surface_tables(file: Path) -> tuple[list[Any], list[Any], list[Any]]:
    """Tables of points, patches and navigation. Refuses a file without them."""
    tables: dict[str, list[Any]] = {topic: [] for topic in SURVEY}
    with BagReader(file) as bag:
        for raw in bag.raw(set(SURVEY)):
            tables[raw.topic].append(decode(bag.message(raw)))
    points, patches, navigation = (tables[topic] for topic in SURVEY)
    if not points or len(points) != len(patches) or len(navigation) != 1:
        raise InputError(
            f"{file}: holds no surface to compare with; replay the recording again",
            reason="survey_file",
            value=str(file),
        )
    return points, patches, navigation


def _settings(
    result: Mapping[str, Any], n: Mapping[str, npt.NDArray[Any]]
) -> tuple[dict[str, dict[str, Any]], Datum | None, tuple[I64, I64, F64, F64, F64 | None]]:
    """Parameters by section, the datum, and the sums of the table ``navigation``."""
    given = {
        s: {k: v for k, v in values.items() if v is not None}
        for s, values in result["parameters"].items()
    }
    datum = None if result["datum"] is None else Datum(**result["datum"])
    sums = (
        n["bin"].astype(np.int64),
        n["states"].astype(np.int64),
        n["C_nav"].reshape(-1, 6, 6),
        n["pose"].reshape(-1, 4, 3),
        n["fixes"].reshape(-1, 2) if "fixes" in n else None,
    )
    return given, datum, sums


def holds_survey(path: Path) -> bool:
    """Whether a folder, or an MCAP file, holds a survey that was replayed or saved."""
    file = path / FILE if path.is_dir() else path
    if file.suffix.lower() != ".mcap" or not file.is_file():
        return False
    try:
        with file.open("rb") as stream:
            return any(r.name == RECORD for r in make_reader(stream).iter_metadata())
    except Exception:  # a damaged file fails anywhere inside the parser; its reader says how
        return True


def read_survey(path: str | Path) -> SavedSurvey:
    """A survey from result.mcap, or from its folder.

    Raises :class:`InputError` (survey_missing; survey_file for a file that is none, or is of a
    version that did not keep the surface), BagError and CloudError for a damaged one.
    """
    file = Path(path) / FILE if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise InputError(
            f"{file}: no such file; replay writes it", reason="survey_missing", value=str(path)
        )
    result = read_result(file)
    points, patches, navigation = _surface_tables(file)
    try:
        given, datum, sums = _settings(result, navigation[0])
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{file}: not a result of this program: {short_repr(error)}",
            reason="survey_file",
            value=str(path),
        ) from error
    parameters = Parameters.read(given, old=True)
    bins = NavigationBins.from_sums(parameters.filter.nav_bin_s, *sums)
    updates = tuple(
        message_tables.filter_update(message_tables.filtered_points(one), two)
        for one, two in zip(points, patches, strict=True)
    )
    return SavedSurvey(file, parameters, bins, updates, datum, result)


def read_result(file: Path) -> dict[str, Any]:
    """The whole result from the metadata of a file. Raises :class:`InputError` (survey_file)."""
    try:
        with file.open("rb") as stream:
            found = [
                r.metadata["result"]
                for r in make_reader(stream).iter_metadata()
                if r.name == RECORD and "result" in r.metadata
            ]
        result: dict[str, Any] = json.loads(found[-1])
    except Exception as error:  # a damaged file fails anywhere inside the parsers
        raise InputError(
            f"{file}: not a result of this program: {short_repr(error)}",
            reason="survey_file",
            value=str(file),
        ) from error
    return result


def between_datums(new: Datum, previous: Datum) -> Transform | None:
    """From the map frame at one datum to that at another, both known exactly; None for the same."""
    if new == previous:
        return None
    one, two = LocalFrame(new), LocalFrame(previous)
    t = two.to_map(new.latitude_deg, new.longitude_deg, new.height_m)
    return Transform(two.R_map_ecef @ one.R_map_ecef.T, t, np.zeros(3), 1.0, np.zeros((7, 7)))

"""Records on the wire: tables that keep every bit a volume depends on, so that nodes over DDS and
offline replay agree.

Positions travel as float64, times as the header stamp plus uint32 nanoseconds (`t`), keys as two
uint32. ``patches`` is a long table, one row per block, told apart by `kind`; its values are
float32: only sigma depends on them, to 1e-7.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ladar_volume.ground.polynomial import degree_of, tilt_of
from ladar_volume.model.errors import CloudError
from ladar_volume.model.ragged_ranges import patch_range
from ladar_volume.model.records import (
    CAL_COLUMNS,
    F32,
    F64,
    I64,
    FilteredPoints,
    FilterUpdate,
    MappedPoints,
    Patches,
    Plane,
    Volume,
    select,
)

if TYPE_CHECKING:  # for names of types alone: a stage's kernels are loaded by the node that runs it
    from ladar_volume.volume.more_data import MoreData

Columns = dict[str, npt.NDArray[Any]]
#: First word of a base's name → number in the table ``volumes``.
BASES = {"ground": 0, "level": 1, "given": 2, "epoch": 3}
HEAD, CROSS, CALIBRATION, NAVIGATION, REMOVED, END = range(6)
#: Columns of M_cal that share one row of the long table, and those of M_nav: the rows of degree 2
#: then are no longer than a cross block.
GROUP = 4
#: Patches of one message.
PART = 400


def _need(columns: Mapping[str, Any], *names: str) -> None:
    missing = [n for n in names if n not in columns]
    if missing:
        raise CloudError(
            f"table without column {', '.join(missing)}", reason="cloud_fields", value=missing
        )


def _split_int64(key: I64) -> Columns:
    unsigned = key.astype(np.uint64)
    return {
        "key_high": (unsigned >> np.uint64(32)).astype(np.uint32),
        "key_low": (unsigned & np.uint64(0xFFFFFFFF)).astype(np.uint32),
    }


def _join_int64(high: Any, low: Any) -> I64:
    key: I64 = ((high.astype(np.uint64) << np.uint64(32)) | low.astype(np.uint64)).astype(np.int64)
    return key


def mapped_columns(points: MappedPoints) -> tuple[int, Columns]:
    """``points_mapped``: header stamp (ns, the earliest return) and columns x y z intensity ring t
    and six of C_ind.
    """
    stamp = int(points.t_ns.min())
    offset = points.t_ns - stamp
    if int(offset.max()) > 0xFFFFFFFF:
        raise CloudError(
            "a cloud longer than 4.29 s cannot be sent",
            reason="cloud_too_long",
            value=int(offset.max()),
        )
    columns: Columns = {axis: points.r_map[:, i] for i, axis in enumerate("xyz")}
    columns |= {"intensity": points.intensity, "ring": points.ring, "t": offset.astype(np.uint32)}
    columns |= {
        f"c{name}": points.C_ind[:, i]
        for i, name in enumerate(("xx", "xy", "xz", "yy", "yz", "zz"))
    }
    return stamp, columns


def mapped_points(stamp_ns: int, columns: Mapping[str, Any]) -> MappedPoints:
    """The inverse of :func:`mapped_columns`. Raises CloudError where a column is missing."""
    names = [f"c{n}" for n in ("xx", "xy", "xz", "yy", "yz", "zz")]
    _need(columns, "x", "y", "z", "intensity", "ring", "t", *names)
    r = np.column_stack([columns[a] for a in "xyz"]).astype(np.float64)
    C = np.column_stack([columns[n] for n in names]).astype(np.float32)
    t_ns = stamp_ns + columns["t"].astype(np.int64)
    return MappedPoints(
        t_ns, r, C, columns["ring"].astype(np.uint16), columns["intensity"].astype(np.float32)
    )


def filtered_columns(points: FilteredPoints) -> Columns:
    """``points_filtered``: x y z, normal, variance along it, tangential covariance, time, patch and
    place on it.
    """
    columns: Columns = {axis: points.r_map[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"normal_{axis}": points.normal[:, i] for i, axis in enumerate("xyz")}
    columns |= {
        "variance": points.variance,
        "tangential": points.C_tangent,
        "u": points.local[:, 0],
        "v": points.local[:, 1],
    }
    time = points.t_ns.astype(np.uint64)
    columns |= {
        "time_high": (time >> np.uint64(32)).astype(np.uint32),
        "time_low": (time & np.uint64(0xFFFFFFFF)).astype(np.uint32),
    }
    return columns | {f"patch_{n[4:]}": v for n, v in _split_int64(points.patch).items()}


def filtered_points(columns: Mapping[str, Any]) -> FilteredPoints:
    """The inverse of :func:`filtered_columns`."""
    _need(
        columns,
        "x",
        "normal_x",
        "variance",
        "tangential",
        "u",
        "v",
        "time_high",
        "time_low",
        "patch_high",
        "patch_low",
    )
    return FilteredPoints(
        np.column_stack([columns[a] for a in "xyz"]),
        np.column_stack([columns[f"normal_{a}"] for a in "xyz"]),
        columns["variance"],
        columns["tangential"],
        _join_int64(columns["time_high"], columns["time_low"]),
        _join_int64(columns["patch_high"], columns["patch_low"]),
        np.column_stack([columns["u"], columns["v"]]),
    )


def patch_columns(update: FilterUpdate) -> Columns:
    """``patches``: the long table. Row kinds: 0 head (`other` its time), 1 cross block (`other` its
    key), 2 calibration columns (`index` the group), those of the beams' residuals last, 3
    navigation bin `other` and last its residual, 4 removed patch, 5 end marker (index 1: the last
    part of an update). Column 13 + p of the head tells whether residuals are known; the next one
    is that of the own voxel, which older tables leave zero.
    """
    a = update.patches
    m, p = a.beta.shape
    known = len(a.nav_residual) > 0
    width = max(p * p, (p + 2) * GROUP + known, 15 + p)
    head = np.zeros((m, width))
    head[:, 0:3], head[:, 3:6], head[:, 6:9] = a.centre, a.normal, a.tangent
    head[:, 9], head[:, 10], head[:, 11], head[:, 12], head[:, 13 : 13 + p] = (
        a.sigma,
        a.used,
        a.M_cal.shape[2],
        p,
        a.beta,
    )
    head[:, 13 + p] = known
    if known and len(a.own_residual):
        head[:, 14 + p] = a.own_residual
    by_bin = a.M_nav.reshape(len(a.nav_bin), (p + 2) * GROUP)
    if known:
        by_bin = np.concatenate([by_bin, a.nav_residual[:, None]], axis=1)
    cal = _group_columns(_with_residuals(a.M_cal, a.beam_residual) if known else a.M_cal)
    groups = cal.shape[1]
    parts = [
        _rows(HEAD, a.key, a.t_ns, 0, head, width),
        _rows(
            CROSS,
            np.repeat(a.key, np.diff(a.cross_start)),
            a.cross_key,
            0,
            a.cross.reshape(-1, p * p),
            width,
        ),
        _rows(
            CALIBRATION,
            np.repeat(a.key, groups),
            np.repeat(a.key, groups),
            np.tile(np.arange(groups), m),
            _long(cal),
            width,
        ),
        _rows(
            NAVIGATION,
            np.repeat(a.key, np.diff(a.nav_start)),
            a.nav_bin,
            0,
            by_bin,
            width,
        ),
        _rows(
            REMOVED, update.removed, update.removed, 0, np.zeros((len(update.removed), 1)), width
        ),
        _rows(
            END,
            np.zeros(1, np.int64),
            np.array([update.t_ns]),
            int(update.complete),
            np.zeros((1, 1)),
            width,
        ),
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _with_residuals(M: F32, residual: F32) -> F32:
    """Sensitivities (m, rows, c) with columns more that hold residuals (m, beams), row by row, the
    last ones filled with zeros.
    """
    m, rows, _ = M.shape
    more = -(-residual.shape[1] // rows)
    out = np.zeros((m, rows * more), np.float32)
    out[:, : residual.shape[1]] = residual
    return np.concatenate([M, out.reshape(m, rows, more)], axis=2)


def _group_columns(M: F32) -> F32:
    """Sensitivities (m, rows, c) in groups of columns, the last one filled with zeros: (m, groups,
    rows, 4).
    """
    m, rows, columns = M.shape
    groups = -(-columns // GROUP)
    out = np.zeros((m, rows, groups * GROUP), np.float32)
    out[:, :, :columns] = M
    return out.reshape(m, rows, groups, GROUP).transpose(0, 2, 1, 3)


def _long(groups: F32) -> F32:
    """The groups (m, groups, rows, 4) as one row each."""
    return groups.reshape(groups.shape[0] * groups.shape[1], groups.shape[2] * groups.shape[3])


def _ungroup_columns(values: F32, m: int, rows: int, columns: int) -> F32:
    """The inverse of both: (m, rows, columns) from rows of the long table."""
    groups = -(-columns // GROUP)
    parts = values[:, : rows * GROUP].reshape(m, groups, rows, GROUP).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(parts.reshape(m, rows, groups * GROUP)[:, :, :columns], np.float32)


def update_parts(update: FilterUpdate, patches: int = PART) -> list[FilterUpdate]:
    """A large update as several messages' worth; only the last is marked complete, all of them
    together are the update.
    """
    m = len(update.patches)
    bounds = [*range(0, m, patches), m] if m else [0, 0]
    parts, a = [], update.patches
    order = np.argsort(a.key, kind="stable")
    at = np.searchsorted(a.key, update.points.patch, sorter=order)
    owner = np.append(order, -1)[at]  # the patch of each point
    for first, last in itertools.pairwise(bounds):
        mine = (owner >= first) & (owner < last)
        removed = update.removed if first == 0 else update.removed[:0]
        parts.append(
            FilterUpdate(
                update.t_ns,
                removed,
                select(update.points, mine),
                Patches(**patch_range(a, first, last)),
                last == m,
            )
        )
    return parts


def no_filtered_points() -> FilteredPoints:
    """A record of no points."""
    return FilteredPoints(
        np.zeros((0, 3)),
        np.zeros((0, 3)),
        np.zeros(0),
        np.zeros((0, 6), np.float32),
        np.zeros(0, np.int64),
        np.zeros(0, np.int64),
        np.zeros((0, 2)),
    )


def _rows(kind: int, key: I64, other: I64, index: Any, values: F32 | F64, width: int) -> Columns:
    n = len(key)
    padded = np.zeros((n, width), np.float32)
    padded[:, : values.shape[1]] = values
    other_split = _split_int64(other)
    return {
        "kind": np.full(n, kind, np.uint8),
        **_split_int64(key),
        "other_high": other_split["key_high"],
        "other_low": other_split["key_low"],
        "index": np.broadcast_to(np.asarray(index, np.uint16), (n,)).copy(),
        "values": padded,
    }


def filter_update(points: FilteredPoints, columns: Mapping[str, Any]) -> FilterUpdate:
    """The update from its two tables. Raises CloudError where they do not fit."""
    _need(columns, "kind", "key_high", "key_low", "other_high", "other_low", "index", "values")
    kind, values = columns["kind"], columns["values"].astype(np.float32, copy=False)
    key, other = (
        _join_int64(columns["key_high"], columns["key_low"]),
        _join_int64(columns["other_high"], columns["other_low"]),
    )
    if not len(kind) or kind[-1] != END:
        raise CloudError(
            "patch table without its end marker", reason="cloud_short", value=len(kind)
        )
    head = values[kind == HEAD].astype(np.float64)
    m = len(head)
    p = int(head[0, 12]) if m else 6 if values.shape[1] >= 36 else 3
    columns_cal = int(head[0, 11]) if m else 0
    keys = key[kind == HEAD]
    known = bool(m and values.shape[1] > (p + 2) * GROUP and head[0, 13 + p])
    beams = (columns_cal - len(CAL_COLUMNS)) // 2
    more = -(-beams // (p + 2)) if known else 0
    nav, groups = kind == NAVIGATION, -(-(columns_cal + more) // GROUP)
    if (
        np.count_nonzero(kind == CALIBRATION) != m * groups
        or columns["index"][nav].any()
        or values.shape[1] < (p + 2) * GROUP
    ):
        raise CloudError(
            "patch table of another format: written by another version", reason="cloud_format"
        )
    bins = other[nav]
    cal = _ungroup_columns(values[kind == CALIBRATION], m, p + 2, columns_cal + more)
    residuals = {}
    if known:
        by_beam = cal[:, :, columns_cal:].reshape(m, (p + 2) * more)[:, :beams]
        residuals = {
            "nav_residual": values[nav][:, (p + 2) * GROUP].copy(),
            "beam_residual": np.ascontiguousarray(by_beam),
            "own_residual": head[:, 14 + p].astype(np.float32),
        }
    patches = Patches(
        keys,
        head[:, 0:3].copy(),
        head[:, 3:6].copy(),
        head[:, 6:9].copy(),
        head[:, 13 : 13 + p].copy(),
        head[:, 9].copy(),
        head[:, 10].astype(np.int32),
        other[kind == HEAD],
        _starts(keys, key[kind == CROSS]),
        other[kind == CROSS],
        values[kind == CROSS][:, : p * p].reshape(-1, p, p).copy(),
        np.ascontiguousarray(cal[:, :, :columns_cal]),
        _starts(keys, key[nav]),
        bins,
        values[nav][:, : (p + 2) * GROUP].reshape(-1, p + 2, GROUP).copy(),
        **residuals,
    )
    return FilterUpdate(
        int(other[-1]), key[kind == REMOVED], points, patches, bool(columns["index"][-1])
    )


def _starts(keys: I64, rows: I64) -> I64:
    """CSR starts of rows that come grouped in the order of sorted ``keys``."""
    return np.concatenate([np.searchsorted(rows, keys), [len(rows)]]).astype(np.int64)


def ground_columns(grounds: Sequence[Plane]) -> Columns:
    """``grounds``: one row per surface, the base of the volumes first (`id` 0): x y z (origin and
    height there), degree, sigma (of its points), support (their number), tilt (rad, at the origin),
    `beta` in the order 1, dx, dy, dx², dx dy, dy², … and `covariance`, the upper triangle of theirs
    by rows. Both are as long as the highest degree needs; a lower one is filled with zeros.
    """
    p = max(len(g.beta) for g in grounds)
    beta, covariance = np.zeros((len(grounds), p)), np.zeros((len(grounds), p, p))
    for row, g in enumerate(grounds):
        k = len(g.beta)
        beta[row, :k], covariance[row, :k, :k] = g.beta, g.C_beta
    upper = np.triu_indices(p)
    return {
        "x": np.array([g.origin_xy[0] for g in grounds]),
        "y": np.array([g.origin_xy[1] for g in grounds]),
        "z": beta[:, 0].copy(),
        "id": np.arange(len(grounds), dtype=np.uint32),
        "degree": np.array([degree_of(g) for g in grounds], np.uint8),
        "sigma": np.array([g.rms_m for g in grounds]),
        "support": np.array([len(g.support) for g in grounds], np.uint32),
        "tilt": np.array([tilt_of(g) for g in grounds]),
        "beta": beta,
        "covariance": covariance[:, upper[0], upper[1]],
    }


def more_data_columns(found: MoreData) -> Columns:
    """``more_data``: one row per cell: x y z of its middle, `gain` (m³, by how much sigma of the
    volume would fall after another pass), `sigma` (m, of the heights there), `side` (m, of the
    cell) and by how much the variance would fall by source, ``fall_<source>``.
    """
    columns: Columns = {axis: found.centre_map[:, i] for i, axis in enumerate("xyz")}
    columns |= {
        "gain": found.gain_m3,
        "sigma": found.sigma_m,
        "side": np.full(len(found.sigma_m), found.cell_m),
    }
    return columns | {f"fall_{name}": found.falls_m6[:, i] for i, name in enumerate(found.sources)}


def base_code(base: str) -> int:
    """A base in words as the number in the table ``volumes``; 255 for a name this does not know."""
    return BASES.get(base.partition(" ")[0], 255)


def volume_columns(volumes: list[Volume]) -> Columns:
    """``volumes``: one row per body with centroid, volume, variance, cut, fill, area, base
    (:data:`BASES`), the share of the area that was seen, the number of doubts, one ``var_<source>``
    per source and one ``doubt_<name>`` per doubt (1 where the row has it).
    """
    centroid = np.array([v.centroid_map for v in volumes], dtype=np.float64)
    columns: Columns = {axis: centroid[:, i] for i, axis in enumerate("xyz")}
    columns |= {
        "volume": np.array([v.volume_m3 for v in volumes]),
        "variance": np.array([v.sigma_m3**2 for v in volumes]),
        "cut": np.array([v.cut_m3 for v in volumes]),
        "fill": np.array([v.fill_m3 for v in volumes]),
        "area": np.array([v.area_m2 for v in volumes]),
        "base": np.array([base_code(v.base) for v in volumes], np.uint8),
        "seen_share": np.array([v.seen_share for v in volumes]),
        "doubts": np.array([len(v.verdict.doubts) for v in volumes], np.uint8),
    }
    for source in sorted({s for v in volumes for s in v.budget_m6}):
        columns[f"var_{source}"] = np.array([v.budget_m6.get(source, 0.0) for v in volumes])
    names = [{doubt.name for doubt in v.verdict.doubts} for v in volumes]
    for name in sorted(set().union(*names)):
        columns[f"doubt_{name}"] = np.array([name in own for own in names], np.uint8)
    return columns

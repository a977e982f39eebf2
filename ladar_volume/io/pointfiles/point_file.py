"""From the columns of a file to a cloud in metres: which columns are the axes, which points count,
and how fine the coordinates are.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ladar_volume.io.pointfiles.crs import Coordinates, Reading, reconcile
from ladar_volume.io.pointfiles.metres import MapCoordinates, metres_of_steps, to_metres
from ladar_volume.io.pointfiles.raw_table import (
    Columns,
    RawTable,
    axis_columns,
    float32_step,
    on_lattice,
    rows_without_return,
    units_of_names,
)
from ladar_volume.math.equal_rows import distinct_rows
from ladar_volume.model.errors import CloudError
from ladar_volume.model.records import F64, I64, Bool
from ladar_volume.model.verdict import Doubt

if TYPE_CHECKING:
    from laspy import LasHeader

#: What the three components of a normal are called; written as the first (PCD and LAS: see
#: cloud_files.NORMALS_OF).
NORMALS = (
    ("nx", "ny", "nz"),
    ("normal_x", "normal_y", "normal_z"),
    ("NormalX", "NormalY", "NormalZ"),
)
#: Classes of LAS that are noise: low points, and high ones.
NOISE = (7, 18)
#: Columns that hold a class, in lower case.
CLASSES = ("classification", "class", "scalar_classification")
#: Steps of float32 from this on, m, are a doubt; from COARSE_M on they are compared to the spacing.
FINE_M, COARSE_M = 0.005, 0.05
#: Fewer numbers than these do not show to how many decimals they were written.
FEW = 100


@dataclass(frozen=True)
class PointFile:
    """A point cloud as its file holds it, in metres.

    r : (n, 3) float64, m, in file order, all finite · columns : everything else by name, (n,) or
    (n, count); the components of a normal are one column "normal" (n, 3), whatever the file calls
    them; standard deviations ("sigma...") in m · file_rows : (n,) the row of each point in the
    file, where points were left out · left_out : how many, by reason · coordinates : CRS and units
    · resolution_m : (3,) smallest step that the file can hold, where that is known · doubts : what
    makes the coordinates doubtful · las : header of a LAS file
    """

    r: F64
    columns: dict[str, npt.NDArray[Any]] = field(default_factory=dict)
    file_rows: I64 | None = None
    left_out: dict[str, int] = field(default_factory=dict)
    coordinates: MapCoordinates = field(default_factory=MapCoordinates)
    resolution_m: F64 | None = None
    doubts: tuple[Doubt, ...] = ()
    las: LasHeader | None = None

    def __len__(self) -> int:
        return len(self.r)

    @property
    def rows(self) -> I64:
        """(n,) the row of each point in the file, from 0."""
        return np.arange(len(self.r)) if self.file_rows is None else self.file_rows


def assemble(table: RawTable, columns: bool, reading: Reading) -> PointFile:
    """The cloud of a table. Raises :class:`CloudError` and :class:`InputError`."""
    found = dict(table.columns)
    r, single, said = _positions(found, table.coordinates)
    keep, left_out = _select_points(r, found, table.las is not None, reading)
    rows = None
    if not keep.all():
        rows = np.flatnonzero(keep)
        r, found = r[rows], {name: c[rows] for name, c in found.items()}
    said = reconcile(said, reading)
    latitude = float(np.median(r[:, 1])) if said.degrees else 0.0
    step = table.step or float32_step(r, single)
    r, at, doubts = to_metres(r, said, reading)
    resolution = None if step is None else metres_of_steps(step, at, latitude)
    if table.las is None and resolution is not None:
        doubts += _too_coarse(r, resolution, table.step is None)
    if columns:
        found = columns_in_metres(_with_normals(found), at)
    return PointFile(
        r,
        found if columns else {},
        rows,
        left_out,
        at,
        resolution,
        tuple(doubts),
        table.las,
    )


def _positions(
    found: Columns, declared: Coordinates | None
) -> tuple[F64, tuple[bool, bool, bool], Coordinates | None]:
    """x, y, z taken out of the columns, which of them are float32, and what their names say."""
    names, degrees = axis_columns(found)
    axes = [found.pop(names[axis]) for axis in "xyz" if axis in names]
    if len(axes) < 3:
        raise CloudError(
            f"there are no columns x, y, z among {', '.join(found) or 'none'}",
            reason="cloud_fields",
            value=list(found),
        )
    if any(a.dtype.kind not in "fiu" or a.ndim != 1 for a in axes):
        raise CloudError("x, y, z are not numbers", reason="cloud_fields")
    r = np.column_stack([a.astype(np.float64) for a in axes])
    if not len(r):
        raise CloudError("there is no point in it", reason="cloud_empty")
    by_name = units_of_names(names)
    if degrees:
        by_name = replace(by_name or Coordinates(), degrees=True, across=None)
    if by_name is not None and declared is None:
        declared = by_name
    x, y, z = (a.dtype == np.float32 for a in axes)
    return r, (x, y, z), declared


def _select_points(
    r: F64, found: Columns, las: bool, reading: Reading
) -> tuple[Bool, dict[str, int]]:
    """(n,) points that count, and how many do not, by reason. Raises :class:`CloudError`
    (cloud_classes) where no point is left.
    """
    missing = rows_without_return(r)
    reasons: dict[str, Bool] = {"no return (NaN)": missing}
    name = next((n for n in found if n.lower() in CLASSES), None)
    numbers = found[name] if name is not None else None
    if numbers is not None and (numbers.dtype.kind not in "fiu" or numbers.ndim != 1):
        numbers = None
    if las and "withheld" in found and reading.classes != ():
        reasons["withheld"] = np.asarray(found["withheld"], dtype=bool)
    if reading.classes is None:
        for noise in NOISE if las and numbers is not None else ():
            reasons[f"noise (class {noise})"] = np.asarray(numbers == noise)
    elif reading.classes:
        if numbers is None:
            raise CloudError(
                "--classes: the file has no column of class numbers (classification)",
                reason="cloud_classes",
            )
        reasons["other classes"] = ~np.isin(numbers, reading.classes)
    keep = np.ones(len(r), dtype=bool)
    left_out: dict[str, int] = {}
    for reason, out in reasons.items():
        count = int(np.count_nonzero(out & keep))
        if count:
            left_out[reason] = count
            keep &= ~out
    if not keep.any():
        words = ", ".join(f"{why} {count}" for why, count in left_out.items())
        have = "" if numbers is None else f"; classes in it: {_classes(numbers)}"
        raise CloudError(
            f"none of {len(r)} points counts ({words}){have}; choose with --classes",
            reason="cloud_classes",
            value=left_out,
        )
    return keep, left_out


def _classes(numbers: npt.NDArray[Any]) -> str:
    values = np.unique(numbers[np.isfinite(numbers)])
    return ", ".join(f"{v:g}" for v in values[:12].tolist())


def _with_normals(found: Columns) -> Columns:
    for triple in NORMALS:
        if set(triple) <= set(found):
            found = {"normal": np.column_stack([found.pop(name) for name in triple]), **found}
    return found


def columns_in_metres(found: Columns, at: MapCoordinates) -> Columns:
    """Standard deviations in metres. Where the axes have unlike units, those that are not along z,
    and normals, have no unit that is known: they are left away.
    """
    across, up = at.factor
    if across == up == 1.0:
        return found
    out: Columns = {}
    for name, c in found.items():
        if name == "normal" and across != up:
            continue
        if name == "sigma_z" or (name.startswith("sigma") and across == up):
            c = c * up if c.dtype.kind in "fiu" else c
        elif name.startswith("sigma"):
            continue
        out[name] = c
    return out


def _too_coarse(r: F64, step: F64, single: bool) -> list[Doubt]:
    """Doubts about coordinates that were rounded. Raises :class:`CloudError` (cloud_resolution)
    where their steps put the points on lines.
    """
    worst = float(step[:2].max())
    if not single and len(r) < FEW:
        return []
    if worst < COARSE_M and not (single and float(step.max()) >= FINE_M):
        return []
    k = int(np.argmax(step[:2]))
    wide = np.maximum(np.ptp(r, axis=0), step)
    spacing = float(np.sqrt(wide[0] * wide[1] / len(r)))
    raster = on_lattice(r[:, 1 - k] - r[0, 1 - k], worst)
    coarse = worst >= COARSE_M and worst > 0.5 * spacing
    lines = single or worst >= 5.0 * float(step[:2].min())  # unlike steps in x and y
    if coarse:
        apart = len(distinct_rows(r[:, :2] if lines else r)) / len(r)
        coarse = not (raster and apart > 0.9) if lines else apart < 0.5
    what = (
        f"at {np.abs(r[:, k]).max():,.0f} m float32 has"
        if single
        else "the numbers in the file have"
    )
    how = (
        "export the coordinates as double, or shifted to a near origin"
        if single
        else "export with more decimals"
    )
    if coarse:
        raise CloudError(
            f"{what} steps of {worst:.3g} m in {'xy'[k]}, points are {spacing:.2g} m apart: they "
            f"lie on {'lines' if lines else 'one another'}; {how}",
            reason="cloud_resolution",
            value=worst,
        )
    if single and not (raster and worst >= FINE_M and step[2] < FINE_M):
        x, y, z = (f"{s:.3g}" for s in step.tolist())
        words = f"{what} steps of {x}, {y}, {z} m in x, y, z: {how}"
        return [Doubt("float32_step", words, float(step.max()))]
    return []

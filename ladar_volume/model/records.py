"""The records that flow from stage to stage. A point and all that is known of it travel in one
record, cut by one mask (:func:`select`); there are no parallel arrays across an interface.

Frames in names: ``r_map`` is a position in the map frame (local ENU at the datum), ``q_map_body``
rotates body (FLU) into map. Quaternions xyzw. Times are int64 nanoseconds. Symmetric 3x3
covariances are packed ``(xx, xy, xz, yy, yz, zz)``.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from ladar_volume.math.array_types import F32 as F32
from ladar_volume.math.array_types import F64 as F64
from ladar_volume.math.array_types import I8 as I8
from ladar_volume.math.array_types import I16 as I16
from ladar_volume.math.array_types import I32 as I32
from ladar_volume.math.array_types import I64 as I64
from ladar_volume.math.array_types import U16 as U16
from ladar_volume.math.array_types import Bool as Bool
from ladar_volume.model.verdict import Verdict

#: Least upward component of a normal along which a height's error is told: a face within 3° of the
#: vertical counts as one of 3°, since the height of a wall is any height. Two places differ:
#: ``second_order`` (curvature grows with its cube) and ``chord_bias`` (no chord over a plan there).
LEAST_UPWARD = 0.05

#: Columns of every calibration sensitivity: per-beam columns follow (rho_k for all beams, then
#: eps_k).
CAL_COLUMNS = (
    "range_bias",
    "boresight_x",
    "boresight_y",
    "boresight_z",
    "lever_laser_x",
    "lever_laser_y",
    "lever_laser_z",
    "lever_antenna_x",
    "lever_antenna_y",
    "lever_antenna_z",
    "clock",
)
#: Columns of every navigation sensitivity: antenna position (map), attitude (body rotation vector).
NAV_COLUMNS = ("east", "north", "up", "attitude_x", "attitude_y", "attitude_z")

R = TypeVar("R")


def select(record: R, mask: I64 | Bool | slice) -> R:
    """The rows of a record chosen by one mask or index array: every row-wise array is cut alike."""
    changes: dict[str, Any] = {}
    for f in dataclasses.fields(record):  # type: ignore[arg-type]
        value = getattr(record, f.name)
        if isinstance(value, np.ndarray):
            changes[f.name] = value[mask]
    return dataclasses.replace(record, **changes)  # type: ignore[type-var]


def concatenate(records: list[R]) -> R:
    """One record with the rows of all; fields that are not arrays are taken from the first."""
    first = records[0]
    changes: dict[str, Any] = {}
    for f in dataclasses.fields(first):  # type: ignore[arg-type]
        if isinstance(getattr(first, f.name), np.ndarray):
            changes[f.name] = np.concatenate([getattr(r, f.name) for r in records])
    return dataclasses.replace(first, **changes)  # type: ignore[type-var]


@dataclass(frozen=True)
class Datum:
    """Origin of the map frame: geodetic latitude and longitude (deg), ellipsoidal height (m), WGS
    84.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float


@dataclass(frozen=True)
class Returns:
    """One cloud in the laser frame.

    t_ns : (n,) int64, ns, time of each return · r_laser : (n, 3) float64, m · ring : (n,) uint16,
    beam 0..15 intensity : (n,) float32
    """

    t_ns: I64
    r_laser: F64
    ring: U16
    intensity: F32

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True)
class Fix:
    """One GNSS fix. ``C_enu`` (3, 3) m² is None where the receiver did not say. ``status`` as
    NavSatStatus.
    """

    t_ns: int
    latitude_deg: float
    longitude_deg: float
    height_m: float
    C_enu: F64 | None
    status: int = 0


@dataclass(frozen=True)
class ImuSample:
    """One attitude. ``q_map_body`` (4,) xyzw; ``omega_body`` (3,) rad/s; ``C_axes`` (3, 3) rad²
    about the map's fixed axes as in sensor_msgs/Imu, None where the sensor did not say.
    """

    t_ns: int
    q_map_body: F64
    omega_body: F64
    C_axes: F64 | None


@dataclass(frozen=True)
class OdometrySample:
    """One pose of the odometry source: position (m) in its world frame, attitude, twist in the body
    frame. ``C_pose`` (6, 6): position, then rotation about fixed axes; None where unknown.
    """

    t_ns: int
    p_map_body: F64
    q_map_body: F64
    v_body: F64
    omega_body: F64
    C_pose: F64 | None


@dataclass(frozen=True)
class PlatformStates:
    """Poses along the path, strictly increasing in time; what `platform` publishes and the filter
    interpolates.

    t_ns : (n,) int64 · p_map_body : (n, 3) m, IMU origin · q_map_body : (n, 4) xyzw · v_body : (n,
    3) m/s, velocity of the IMU origin in the body frame · omega_body : (n, 3) rad/s · C_nav : (n,
    6, 6), antenna position (map, m²) and attitude (body rotation vector, rad²): the navigation's
    total covariance, before its split into bias, Markov and white parts · segment : (n,) int64,
    changes where a gap in the trajectory forbids interpolation · fix_gap_s : (n,) s, between the
    fixes around; None where it is not known.
    """

    t_ns: I64
    p_map_body: F64
    q_map_body: F64
    v_body: F64
    omega_body: F64
    C_nav: F64
    segment: I64
    fix_gap_s: F64 | None = None

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True)
class MappedPoints:
    """Georeferenced returns.

    t_ns : (n,) int64 · r_map : (n, 3) float64, m · C_ind : (n, 6) float32, m², the independent part
    only (see UNCERTAINTY: shared errors never enter here) · ring : (n,) uint16 · intensity : (n,)
    float32
    """

    t_ns: I64
    r_map: F64
    C_ind: F32
    ring: U16
    intensity: F32

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True)
class FilteredPoints:
    """Surface points projected onto their patch.

    r_map : (n, 3) m · normal : (n, 3) unit, towards the sensor · variance : (n,) m², independent
    noise along the normal · C_tangent : (n, 6) float32 m², independent noise in the tangent plane ·
    t_ns : (n,) mean time of the returns · patch : (n,) int64 key of the patch · local : (n, 2) m,
    tangent coordinates (u, v) in the patch frame
    """

    r_map: F64
    normal: F64
    variance: F64
    C_tangent: F32
    t_ns: I64
    patch: I64
    local: F64

    def __len__(self) -> int:
        return len(self.patch)


def no_residuals() -> F32:
    """Residuals that are not known."""
    return np.zeros(0, np.float32)


@dataclass(frozen=True)
class PatchTable:
    """Local least-squares surfaces, one per voxel, sorted by key; ragged parts in CSR form. What
    :class:`Patches`, as they are sent, and :class:`HeldPatches`, as they are held, have in common.

    Height over the tangent plane: ``w(u, v) = x(u, v) @ beta`` with ``x = (1, u, v)`` or ``(1, u,
    v, u², uv, v²)``; a point is ``centre + u tangent + v (normal x tangent) + w normal``.

    key : (m,) int64, unique and stable · centre, normal, tangent : (m, 3) · beta : (m, p) · sigma :
    (m,) m, robust residual scale · used : (m,) int32 inliers in the fit · t_ns : (m,) mean time ·
    cross_start : (m + 1,), cross_key : (k,) keys of neighbours with key >= own key (own block
    first), cross : (k, p, p) the covariance blocks ``C_ab`` of UNCERTAINTY step 3 · M_cal : mean
    sensitivities to the calibration columns: of beta, then of the place along tangent and binormal,
    which moves with the returns · nav_start : (m + 1,), nav_bin : (l,) int64 ``floor(t /
    nav_bin)``, M_nav : (l, p + 2, 4) the same per navigation time bin, or for some bins that stand
    for all: by the platform's position along the normal (of beta), the tangent and the binormal,
    across which it does nothing, then by its attitude · nav_residual : (l,) m, mean residuals of
    the inliers of each bin, and beam_residual : (m, beams) m, of those of each beam less what their
    bins are off; NaN, or both of no length, where they are not known · own_residual : (m,) m, mean
    residual of the inliers in the patch's own voxel; zero, or of no length, where it is not known
    """

    key: I64
    centre: F64
    normal: F64
    tangent: F64
    beta: F64
    sigma: F64
    used: I32
    t_ns: I64
    cross_start: I64
    cross_key: I64
    cross: F32 | I8
    M_cal: F32
    nav_start: I64
    nav_bin: I64
    M_nav: F32 | I16
    nav_residual: F32 = field(default_factory=no_residuals, kw_only=True)
    beam_residual: F32 = field(default_factory=no_residuals, kw_only=True)
    own_residual: F32 = field(default_factory=no_residuals, kw_only=True)

    def __len__(self) -> int:
        return len(self.key)


@dataclass(frozen=True)
class Patches(PatchTable):
    """Patches as the filter sends them. cross : float32 m² · M_cal : (m, p + 2, c) float32 · M_nav
    : float32
    """

    cross: F32
    M_nav: F32


@dataclass(frozen=True)
class HeldPatches(PatchTable):
    """Patches as they are held, about half as large: the blocks ``factor_a cross_ab factor_bᵀ``
    with cross int8; M_nav int16, each row times its unit for position and for attitude; of M_cal
    only the columns that all beams share, those of single beams in M_beam as int16, each row times
    its unit for their ranges and for their vertical angles (see ``uncertainty.packing``).

    factor : (m, p, p) float32 · nav_unit : (m, p + 2, 2) float32 · M_cal : (m, p + 2, 11) float32 ·
    M_beam : (m, p + 2, 2 beams) int16 · beam_unit : (m, p + 2, 2) float32
    """

    cross: I8
    M_nav: I16
    factor: F32
    nav_unit: F32
    M_beam: I16
    beam_unit: F32


@dataclass(frozen=True)
class FilterUpdate:
    """What changed in the filtered surface: every patch in ``removed`` or in ``patches.key`` is to
    be forgotten with its points and with all its cross blocks, those held by other patches too;
    then the new ones added. A cross block with a patch that did not change and has the lower key
    comes with the patch that did: its ``cross_key`` is then the lower one, the block itself is that
    patch's, ``C_ba``. The union of all updates equals one update from the whole input. Not
    ``complete``, an update is continued by the next one.
    """

    t_ns: int
    removed: I64
    points: FilteredPoints
    patches: Patches
    complete: bool = True


@dataclass(frozen=True)
class Tin:
    """A triangulated surface over the map's horizontal plane.

    vertices : (n, 3) m · triangles : (m, 3) int32, counter-clockwise from above · relevant : (m,)
    bool · source : (n,) int64, index of each vertex in the points it was built from · neighbours :
    (m, 3) int32, triangle across the edge opposite each vertex, −1 at the hull
    """

    vertices: F64
    triangles: I32
    neighbours: I32
    relevant: Bool
    source: I64
    duplicates: int = 0


@dataclass(frozen=True)
class Plane:
    """A base surface ``z = x(dx, dy) @ beta`` about ``origin_xy``: degree 0 (level), 1 (plane), 2
    or 3.

    origin_xy : (2,) m · beta : (p,) with x = (1, dx, dy[, dx², dx dy, dy²[, dx³, dx² dy, dx dy²,
    dy³]]) · C_beta : (p, p) independent part · support : (k,) int64 indices of the points that
    define it (empty for a design surface) · unsettled_m3 : what the volume changes by where base
    and outline, which define each other, go on changing
    """

    origin_xy: F64
    beta: F64
    C_beta: F64
    support: I64
    rms_m: float = 0.0
    unsettled_m3: float = 0.0


@dataclass(frozen=True)
class Gap:
    """Part of an outline where nothing was seen: x, y of its middle, its area and greatest extent,
    the standard deviation of the volume under it (NaN where nothing can be told), and how much its
    surface has beyond the triangles that span it.
    """

    x_m: float
    y_m: float
    area_m2: float
    size_m: float
    sigma_m3: float
    more_m3: float


@dataclass(frozen=True)
class StandingObject:
    """What stood on the surface and was taken out: x, y of its middle, its greatest extent and
    height above the surface below, m, the volume between, m³ · inside : whether in an outline
    """

    x_m: float
    y_m: float
    size_m: float
    high_m: float
    volume_m3: float
    inside: bool


@dataclass(frozen=True)
class SourceAgreement:
    """What one group of sources has to do with the scatter of the passes. name : of the group ·
    predicted_m : its part of the median patch's residual by the budget · factor : by which its
    variance would have to be larger, were it alone to blame, and sigma of that factor, NaN where
    only the size of the residuals is known · freedom : its independent errors that passes tell
    apart · p_value : of a factor as large, were its budget true · visible : whether its part is
    large enough to be judged at all · scale : by which its variances are made larger, 1 where they
    are not refuted
    """

    name: str
    predicted_m: float
    factor: float
    freedom: float
    p_value: float
    visible: bool
    sigma: float = math.nan
    scale: float = 1.0


@dataclass(frozen=True)
class Agreement:
    """How the returns of a survey agree with each other. residual_m : of the median patch, RMS ·
    predicted_m : the same by the budget · factor : by which the variances of what returns share
    would have to be larger, 1 cm of roughness allowed · freedom : independent errors it was told
    from · p_value : of a factor as large, were the budget true · refuted : whether it is not ·
    sources : the same by group of sources · shift_m : by how much passes lie apart sideways, 0
    where not, and shift_deg : along which direction, counter-clockwise from east, 0 to 180
    """

    residual_m: float
    predicted_m: float
    factor: float
    freedom: float
    p_value: float
    refuted: bool
    sources: tuple[SourceAgreement, ...] = ()
    shift_m: float = 0.0
    shift_deg: float = 0.0


@dataclass(frozen=True)
class Volume:
    """A volume with its budget. Net = cut − fill inside the outline. ``budget_m6`` adds up to
    ``sigma_m3 ** 2``. ``folded_m3`` : taken from cut and from fill by the folded-normal correction,
    where the surface runs near its base, over ``near_area_m2``; net is not touched.
    ``budget_within_m6`` : marginal variances inside the line ``calibration`` where its sources are
    correlated; they do not add up to it. ``second_order_m3`` : mean second-order effect of the
    uncertain boresight and attitude, not corrected but in lines of the budget, and whether that
    ``second_order_matters``. ``chord_m3`` : taken from the volume, and from cut and fill, for what
    the surface's chords span above hollows and below crests; ``smoothing_m3`` : the same for what
    the filter's fits smoothed away, as at the toe; ``cover_m3`` : added for plants whose height the
    user gave. ``seen_share`` : of the area, where
    points were seen; ``gaps`` : the largest places where none were, bridged, with a line
    ``unseen`` of the budget. ``objects`` : what stood on the surface, is not counted, and hides
    what is bridged. ``agreement`` : of the passes with the budget, where it was asked.
    """

    volume_m3: float
    sigma_m3: float
    confidence: float
    coverage_factor: float
    cut_m3: float
    fill_m3: float
    area_m2: float
    base: str
    base_same_survey: bool
    centroid_map: tuple[float, float, float]
    budget_m6: dict[str, float]
    sigma_tau_range_m3: tuple[float, float]
    sigma_naive_m3: float
    outline: F64
    vertices: int
    triangles: int
    t_ns: int
    folded_m3: float = 0.0
    near_area_m2: float = 0.0
    budget_within_m6: dict[str, float] = field(default_factory=dict)
    second_order_m3: float = 0.0
    second_order_matters: bool = False
    chord_m3: float = 0.0
    smoothing_m3: float = 0.0
    cover_m3: float = 0.0
    seen_share: float = 1.0
    gaps: tuple[Gap, ...] = ()
    objects: tuple[StandingObject, ...] = ()
    agreement: Agreement | None = None
    verdict: Verdict = field(default_factory=Verdict)

    @property
    def interval_m3(self) -> tuple[float, float]:
        """The coverage interval ``V ± k sigma``."""
        half = self.coverage_factor * self.sigma_m3
        return self.volume_m3 - half, self.volume_m3 + half

    @property
    def largest_source(self) -> str:
        """The budget line with the largest variance; empty without a budget."""
        return (
            max(self.budget_m6, key=lambda source: self.budget_m6[source]) if self.budget_m6 else ""
        )

    @property
    def sigma_if_halved_m3(self) -> dict[str, float]:
        """By source: sigma of the volume if the standard deviations of that source alone were half
        as large.
        """
        total = sum(self.budget_m6.values())
        return {
            source: math.sqrt(max(0.0, total - 0.75 * line))
            for source, line in self.budget_m6.items()
        }


@dataclass(frozen=True)
class Estimate:
    """What one estimation gives: the volume (of the main body), the surface, its base.

    grounds : the ground surfaces, the base first; empty above a level or a given plane · bodies :
    every body's volume, the main one first · C_bodies_m6 : (k, k) their covariance, None for one
    body or very many
    """

    volume: Volume
    tin: Tin
    base: Plane
    grounds: tuple[Plane, ...] = ()
    bodies: tuple[Volume, ...] = ()
    C_bodies_m6: F64 | None = None

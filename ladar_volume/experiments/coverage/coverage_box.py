"""The closed box of ``ladar_volume study coverage``: where rays meet it, and its volume as a closed
body with the budget of a survey.

Roof and four walls are seen from the air, the bottom is not. The body is meshed in any direction,
its edges completed and its bottom closed on the ground around it; the gradient of its volume by
every surface point, those of the ground included, goes through the survey's sources as any other's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.clouds.body_volume import Body, closing_m6
from ladar_volume.clouds.cloud_bodies import cloud_bodies
from ladar_volume.clouds.ground_readings import field_under
from ladar_volume.experiments.coverage.coverage_scene import SLOPE, RoughGround
from ladar_volume.ground.ground_adjoint import ground_gradient, ground_residuals
from ladar_volume.ground.objects import find_objects
from ladar_volume.ground.robust_ground import fit_ground
from ladar_volume.model.body_parameters import BodyParameters, LocalMeshParameters, ObjectParameters
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import GroundParameters, Parameters
from ladar_volume.model.records import F64, I64, Bool, FilteredPoints, PatchTable, Plane
from ladar_volume.uncertainty.ground_field import GroundField
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.roughness import estimate_roughness
from ladar_volume.uncertainty.volume_budget import Budget, Sources
from ladar_volume.volume.volume_loads import shared_covariance_of

#: Lowest points of the box that are not taken for ground, m above it.
LEAST_M = 0.06
#: Gaps up to half the height are closed, and rims so far above the ground drawn on to it, m: a
#: third of a metre is left in most. A wall that was not meshed is refused (closing_height,
#: closing_gap).
CLOSE_M = 1.25
#: Vertical component of the normals of what may be ground.
LEVEL = 0.7


def one_per_cube(r: F64, cell_m: float) -> I64:
    """The first (k,) of the points (n, 3) in each cube of this side."""
    cube = np.floor(r / cell_m).astype(np.int64)
    x, y, z = (cube - cube.min(axis=0, initial=0)).T
    _, first = np.unique(
        (x * (y.max(initial=0) + 1) + y) * (z.max(initial=0) + 1) + z, return_index=True
    )
    return np.sort(first).astype(np.int64)


@dataclass(frozen=True)
class BoxSite:
    """A box on rough, tilted ground, centred at the origin, its roof level. size_m : length, width,
    height above the mean ground beneath · cell_m : one return is a vertex in each cube of this side
    · the rest as in :class:`~ladar_volume.experiments.coverage.coverage_scene.Site`
    """

    name: str
    size_m: tuple[float, float, float]
    around_m: float
    flight_m: tuple[float, float]
    pulses: int
    rough_m: float = 0.003
    length_m: float = 0.7
    sector_rad: float = math.radians(70.0)
    cell_m: float = 0.12

    @property
    def volume_m3(self) -> float:
        """Volume, m³."""
        return math.prod(self.size_m)

    @property
    def half_m(self) -> tuple[float, float]:
        """Half length and width of the surveyed rectangle."""
        return 0.5 * self.size_m[0] + self.around_m, 0.5 * self.size_m[1] + self.around_m

    @property
    def heights_m(self) -> tuple[float, float]:
        """Between which the site lies, m, its ground's slope left out."""
        return 0.0, self.size_m[2]

    def ground(self, seed: int) -> RoughGround:
        """The ground of one survey."""
        return RoughGround(self.rough_m, self.length_m, seed, self.half_m)

    def ranges(self, origin: F64, ray: F64, ground: RoughGround) -> F64:
        """Distance (n,) m along downward unit rays (n, 3) from origins (n, 3) m to their first hit
        within the rectangle, NaN without.
        """
        slope = np.array(SLOPE)
        smooth = t = (origin[:, :2] @ slope - origin[:, 2]) / (ray[:, 2] - ray[:, :2] @ slope)
        near = np.flatnonzero(
            (np.abs(origin[:, :2] + t[:, None] * ray[:, :2]) <= np.array(self.half_m) + 0.2).all(
                axis=1
            )
        )
        o, d, t = origin[near, :2], ray[near, :2], t.copy()
        fall = ray[near, 2] - d @ slope
        for _ in range(3):  # the roughness is small: the beam meets it a little before or after
            t[near] = smooth[near] + ground(o + t[near, None] * d) / fall
        half = 0.5 * np.array(self.size_m[:2])
        roof = ground.mean_over_box(float(half[0]), float(half[1])) + self.size_m[2]
        with np.errstate(divide="ignore"):
            sides = (np.stack([-half, half])[:, None] - origin[:, :2]) / ray[:, :2]
        enter = np.maximum(sides.min(axis=0).max(axis=1), (roof - origin[:, 2]) / ray[:, 2])
        hit = (enter < sides.max(axis=0).min(axis=1)) & (enter < t)
        out = np.where(hit, enter, t)
        at = origin[:, :2] + out[:, None] * ray[:, :2]
        return np.where((np.abs(at) <= np.array(self.half_m)).all(axis=1), out, np.nan)

    def sampled(self, true: F64) -> I64:
        """The hits (k,) among (n, 3) m, NaN for none, that are vertices: the first in each cube, as
        the filter caps what a voxel holds. A roof seen from above would have ten times the points
        of a wall.
        """
        seen = np.flatnonzero(np.isfinite(true[:, 0]))
        return seen[one_per_cube(true[seen], self.cell_m)]

    def normals_at(self, true: F64) -> F64:
        """Outward unit normals (n, 3) of the faces that the rays truly hit at (n, 3) m."""
        out: F64 = np.tile(
            np.array([-SLOPE[0], -SLOPE[1], 1.0]) / math.sqrt(1.0 + SLOPE[0] ** 2 + SLOPE[1] ** 2),
            (len(true), 1),
        )
        beyond = np.abs(true[:, :2]) - 0.5 * np.array(self.size_m[:2])
        over = (beyond < 1e-6).all(axis=1)
        wall = over & (np.abs(beyond) < 1e-6).any(axis=1)
        out[over] = [0.0, 0.0, 1.0]
        side = np.argmax(beyond, axis=1)[wall]
        out[wall] = 0.0
        out[np.flatnonzero(wall), side] = np.sign(true[wall, side])
        return out


@dataclass(frozen=True)
class ClosedBox:
    """volume_m3 · budget_m6 : variance of every line, with ``closing`` for how the bottom was
    closed · sigma_naive_m3 · sigma_tau_range_m3 : as of any volume
    """

    volume_m3: float
    budget_m6: dict[str, float]
    sigma_naive_m3: float
    sigma_tau_range_m3: tuple[float, float]

    @property
    def sigma_m3(self) -> float:
        """Standard deviation, m³."""
        return math.sqrt(sum(self.budget_m6.values()))


def height_variance(points: FilteredPoints) -> F64:
    """Independent variance (n,) m² of the height of the surface at each point; a wall has none to
    speak of.
    """
    out: F64 = points.variance / np.maximum(np.abs(points.normal[:, 2]), 0.1) ** 2
    return out


def body_on_ground(points: FilteredPoints, longest_m: float = 0.0) -> tuple[Body, F64, Plane]:
    """The largest body among surface points, the gradient (n, 3) of its volume by all of them, and
    the ground it stands on.

    longest_m : edge of the mesh, 0: from the spacing.
    """
    level = np.flatnonzero(points.normal[:, 2] > LEVEL)
    ground = fit_ground(
        points.r_map, height_variance(points), GroundParameters(degree=1), select=level
    )
    label = find_objects(points.r_map, [ground], ObjectParameters(min_height_m=LEAST_M)).label
    options = BodyParameters(LocalMeshParameters(longest_m), CLOSE_M)
    flat: Bool = np.zeros(len(points), bool)
    made = cloud_bodies(
        points.r_map, points.normal, flat, np.where(label == 0, 0, -1), ground, options
    )
    if made.failed:
        raise VolumeError(made.failed[0].reason, reason="body_failed")
    body, gradient = made.bodies[0], np.zeros((len(points), 3))
    gradient[made.sources[0]] = body.gradient
    gradient[ground.support] += ground_gradient(points.r_map, ground, body.by_ground[:, None])[:, 0]
    return body, gradient, ground


def under_body(body: Body, sources: Sources, ground: Plane) -> GroundField:
    """How the ground's deviation from its plane enters: under the body, where it is not seen, and
    through the fit.
    """
    points = sources.points
    xy, residual, _ = ground_residuals(points.r_map, ground, body.by_ground)
    rough = estimate_roughness(
        xy,
        residual,
        height_variance(points)[ground.support],
        len(ground.beta),
        shared_covariance_of(sources, ground.support),
    )
    return field_under(body, points.r_map, ground, rough)


def closed_box(
    points: FilteredPoints,
    patches: PatchTable,
    navigation: NavigationBins,
    parameters: Parameters,
    longest_m: float = 0.0,
) -> ClosedBox:
    """The largest body of a survey's surface as a closed mesh with edges up to ``longest_m``, with
    the survey's own budget.
    """
    body, gradient, ground = body_on_ground(points, longest_m)
    sources = Sources(points, patches, navigation, parameters)
    rough_m6 = under_body(body, sources, ground).variance_m6
    budget: Budget = sources.budget(
        sources.sensitivities(gradient[:, None]), rough_m6, sources.naive_sigma(gradient)
    )
    closing = closing_m6(body)
    low, high = (math.sqrt(s * s + closing) for s in budget.sigma_tau_range)
    return ClosedBox(
        body.volume_m3, {**budget.lines, "closing": closing}, budget.sigma_naive, (low, high)
    )


BOX = BoxSite("box", (6.0, 2.5, 2.5), 2.5, (7.0, 7.0), 120_000)

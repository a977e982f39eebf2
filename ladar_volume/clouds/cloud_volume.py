"""Volumes of point clouds: above a base, or between two surfaces, with the standard deviation that
the noise of the points gives them.

Every result goes back to the points through the adjustment of the heights (UNCERTAINTY step 5).
Where a surface runs near its base, cut and fill are corrected for the noise that folds into both
(step 7, "folded normal"); the net volume is not touched. What all points of a cloud share, such as
calibration and navigation, a file does not tell: it is not in these standard deviations.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np

from ladar_volume.change.surface_difference import along_curve, difference
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.ground.ground_adjoint import ground_inverse, ground_residuals
from ladar_volume.ground.heights import height_above
from ladar_volume.ground.polynomial import (
    degree_of,
    design_surface,
    monomials,
)
from ladar_volume.model.errors import GroundError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, Bool, Plane, Tin
from ladar_volume.tin.full_tin import any_corner
from ladar_volume.volume.base import base_and_outline, polygon_of
from ladar_volume.volume.near_base import REACH, NearBase, WholeFold, near_base
from ladar_volume.volume.neighbourhood import SparseF64
from ladar_volume.volume.overlay import volumes_between
from ladar_volume.volume.polygon import clipped_prismoids
from ladar_volume.volume.prismoids import Prismoids, prismoids
from ladar_volume.volume.volume_loads import base_name, ground_field, whole_triangles

#: A level of zero, above which differences stand.
ZERO = design_surface([0.0])


@dataclass(frozen=True)
class Solid:
    """One volume before its noise: raw cut and fill m³, area m² · gradients : (n, 2) by the vertex
    heights, of net and cut, for every surface it depends on · correction : near the base, None
    where the noise is not known or nothing is near · curved_m6 : second-order variance of cut and
    fill, and of what remains of the fold · extra : further variances m⁶ of the net volume, by
    source
    """

    cut_m3: float
    fill_m3: float
    area_m2: float
    gradients: tuple[tuple[CloudSurface, F64], ...]
    correction: WholeFold | None
    curved_m6: float
    extra: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class CloudVolume:
    """cut_m3, fill_m3 : corrected, both 0 or more for one base · cut_raw_m3, fill_raw_m3 : of the
    surface as it is · folded_m3 : what was taken from both (NaN where the noise is not known), over
    near_area_m2 · sigma_* : standard deviations from the noise of the points, NaN where it is not
    known · budget_m6 : variances of the net volume by source · base : in words · base_same_survey :
    whether it comes from the cloud itself · freedom : independent places of the ground that
    ``base_surface`` was told from · cover_m3 : added for plants whose height the user gave
    """

    cut_m3: float
    fill_m3: float
    cut_raw_m3: float
    fill_raw_m3: float
    folded_m3: float
    near_area_m2: float
    sigma_m3: float
    sigma_cut_m3: float
    sigma_fill_m3: float
    area_m2: float
    base: str
    base_same_survey: bool
    budget_m6: dict[str, float]
    freedom: float = math.inf
    cover_m3: float = 0.0

    @property
    def net_m3(self) -> float:
        """Cut minus fill, m³."""
        return self.cut_m3 - self.fill_m3


def corrected_volume(solid: Solid, base: str, same_survey: bool) -> CloudVolume:
    """The volume with its correction and standard deviations."""
    total, shared = np.zeros(3), dict[str, F64]()
    for surface, gradient in solid.gradients:
        total += surface.variance(gradient, apart=True)
        if surface.shared_errors or surface.flight is not None:
            columns = np.c_[gradient, gradient[:, 1] - gradient[:, 0]]
            for name, line in surface.shared_lines(columns).items():
                shared[name] = shared.get(name, np.zeros(3)) + line
    return with_noise(solid, total, shared, base, same_survey)


def with_noise(
    solid: Solid, total: F64, shared: dict[str, F64], base: str, same_survey: bool
) -> CloudVolume:
    """The same from the variances (3,) m⁶ of net, cut and fill by the noise of the points, and by
    what they share.
    """
    extra = sum(solid.extra.values()) + sum(shared.values())
    net, cut, fill = np.sqrt(
        np.maximum(total + extra + [0.0, solid.curved_m6, solid.curved_m6], 0.0)
    ).tolist()
    near = solid.correction
    folded = (
        math.nan
        if math.isnan(net)
        else 0.0
        if near is None
        else near.removed_m3(solid.cut_m3, solid.fill_m3)
    )
    taken = 0.0 if math.isnan(folded) else folded
    if near is not None and near.correction_m3 + near.remaining.fold_m3 > taken:
        # one of the two is 0, and the other the net volume: no surer than that
        cut, fill = max(cut, net), max(fill, net)
    return CloudVolume(
        solid.cut_m3 - taken,
        solid.fill_m3 - taken,
        solid.cut_m3,
        solid.fill_m3,
        folded,
        0.0 if near is None else near.near_area_m2,
        net,
        cut,
        fill,
        solid.area_m2,
        base,
        same_survey,
        {"noise": float(total[0]), **solid.extra, **{k: float(v[0]) for k, v in shared.items()}},
    )


def has_selected_vertices(surface: CloudSurface) -> bool:
    """Whether the vertices are some of the points, chosen by their heights; copies of a footprint,
    and points that stand alone beyond what was sampled, are not.
    """
    made = surface.representation
    footprints = len(surface.points) - made.off_map_count - made.tin.duplicates
    footprints -= 0 if made.sampled_area is None else made.sampled_area.beyond
    return int(np.count_nonzero(made.tin.source >= 0)) < footprints


def comes_near(tin: Tin, base: Plane, sigma_m: F64 | None, mask: Bool) -> bool:
    """Whether any triangle of the mask (m,) could lie within reach of the noise above or below the
    base.
    """
    if sigma_m is None or not sigma_m.any():
        return False
    height = height_above(tin.vertices, base)
    reach, t = REACH * float(sigma_m.max()), tin.triangles[mask]
    return bool((any_corner(t, height <= reach) & any_corner(t, height >= -reach)).any())


def above_base(
    surface: CloudSurface, parameters: Parameters, correct: bool = True
) -> tuple[CloudVolume, Plane, Bool]:
    """Cut and fill above the base and within the outline of the parameters; also that base and the
    triangles (m,) that count. Not ``correct``, cut and fill stay as they are near the base, and
    their variances first order.

    Raises :class:`GroundError` where no ground can be fitted, :class:`VolumeError` where nothing
    lies inside the outline.
    """
    tin = surface.representation.tin
    C = None
    if parameters.volume.base == "ground" and surface.sigma_m is not None:
        C = surface.representation.covariance(surface.sigma_m)
    variance = np.zeros(len(tin.vertices)) if C is None else C.diagonal()
    base, inside = ground_and_outline(tin, variance, parameters)
    solid = solid_above(surface, base, inside, parameters, variance, correct, C)
    del C, variance  # what follows needs the memory
    return (
        corrected_volume(solid, base_name(parameters), parameters.volume.base == "ground"),
        base,
        inside > 0,
    )


def ground_and_outline(tin: Tin, variance: F64, parameters: Parameters) -> tuple[Plane, F64]:
    """:func:`base_and_outline` of a cloud. Raises :class:`GroundError` (ground_none_around) where
    bodies leave no ground around them.
    """
    try:
        return base_and_outline(tin, variance, parameters)
    except GroundError as error:
        if parameters.volume.outline != "auto" or error.reason != "ground_too_few_points":
            raise
        words = (
            "no ground is left around what rises above it: the body takes up the survey; take more "
            "of its surroundings, or give --level, --plane or a second cloud"
        )
        raise GroundError(words, reason="ground_none_around", value=0) from error


def solid_within(tin: Tin, base: Plane, mask: Bool, parameters: Parameters) -> Prismoids:
    """Cut, fill and net of the triangles (m,), cut off by the polygon where one is given; the last
    column of its gradients is that by the heights.
    """
    if parameters.volume.outline == "polygon":
        return clipped_prismoids(tin, base, polygon_of(parameters.volume), mask)
    return prismoids(tin, base, mask, sideways=False)


def solid_above(
    surface: CloudSurface,
    base: Plane,
    inside: F64,
    parameters: Parameters,
    variance: F64,
    correct: bool = True,
    covariance: SparseF64 | None = None,
) -> Solid:
    """The solid above a base; ``inside`` (m,) m² is the area of each triangle within the outline,
    covariance (n, n) m² that of the heights, where it is known already.
    """
    tin, mask = surface.representation.tin, inside > 0
    by_polygon = parameters.volume.outline == "polygon"
    found = solid_within(tin, base, mask, parameters)
    volumes, base_net = (found.cut_m3, found.fill_m3, found.area_m2), found.base_net
    net, cut = (g[:, -1].copy() for g in (found.gradient_net, found.gradient_cut))
    del found
    near, curved = None, 0.0
    # a triangle that the outline cuts is left uncorrected
    whole = whole_triangles(tin, inside) if by_polygon else mask
    if correct and surface.sigma_m is not None and comes_near(tin, base, surface.sigma_m, whole):
        C = surface.representation.covariance(surface.sigma_m) if covariance is None else covariance
        near = near_base(tin, base, C, whole, selected=has_selected_vertices(surface))
        curved = near.variance_m6
        cut = cut if by_polygon else near.gradient_cut
    gradient, extra = np.stack([net, cut], axis=1), dict[str, float]()
    if len(base.support):
        # the base moves with the points that define it
        columns = monomials(tin.vertices[:, :2], base.origin_xy, degree_of(base))
        by_cut = -np.array([cut.sum(), *(column @ cut for column in columns)])
        by_beta = np.stack([base_net, by_cut], axis=1)
        N = ground_inverse(tin.vertices, base)
        for k in range(2):
            gradient[base.support, k] += ground_residuals(tin.vertices, base, by_beta[:, k], N)[2]
        field = ground_field(tin, base, base_net, inside, variance)
        if field is not None:
            extra["base_surface"] = field.variance_m6
    return Solid(*volumes, ((surface, gradient),), near, curved, extra)


def between_clouds(
    upper: CloudSurface, lower: CloudSurface, lower_name: str, correct: bool = True
) -> CloudVolume:
    """Cut where ``upper`` is above ``lower``, fill where it is below, over their common footprint.

    Raises :class:`VolumeError` where the two have no area in common.
    """
    one, two = upper.representation.tin, lower.representation.tin
    found, near, curved = volumes_between(one, two), None, 0.0
    net, cut = (
        [found.gradient_net[:, 2], found.lower_net[:, 2]],
        [found.gradient_cut[:, 2], found.lower_cut[:, 2]],
    )
    if correct and upper.sigma_m is not None and lower.sigma_m is not None:
        near, shares = near_difference(upper, lower)
        if near is not None:
            curved = near.variance_m6
            cut = [
                np.where(np.isfinite(share), share * g, c)
                for share, g, c in zip(shares, net, cut, strict=True)
            ]
    gradients = tuple(
        (s, np.stack(g, axis=1)) for s, *g in zip((upper, lower), net, cut, strict=True)
    )
    solid = Solid(found.cut_m3, found.fill_m3, found.area_m2, gradients, near, curved)
    return corrected_volume(solid, f"surface of {lower_name} over the common footprint", False)


def near_difference(
    upper: CloudSurface, lower: CloudSurface
) -> tuple[NearBase | None, tuple[F64, ...]]:
    """The correction between two surfaces, None where they are nowhere near one another, and what
    part of each vertex' derivative of the net volume that of the cut is.
    """
    if upper.sigma_m is None or lower.sigma_m is None:
        return None, ()
    (one, first), (two, second) = (
        along_curve(upper.representation.tin),
        along_curve(lower.representation.tin),
    )
    apart = difference(one, two)
    sigma = np.array([math.hypot(upper.sigma_m.max(), lower.sigma_m.max())])
    if not comes_near(apart.tin, ZERO, sigma, apart.tin.relevant):
        return None, ()
    C_one, C_two = (
        upper.representation.covariance(upper.sigma_m)[first][:, first],
        lower.representation.covariance(lower.sigma_m)[second][:, second],
    )
    own, other, below = (C_one, C_two, two) if apart.upper_carries else (C_two, C_one, one)
    C = apart.covariance(own, below, other)
    near = near_base(
        apart.common(),
        ZERO,
        C,
        selected=has_selected_vertices(upper) or has_selected_vertices(lower),
    )
    carried, rest = apart.shares(near.gradient_cut, near.gradient_net, len(below.vertices))
    ordered = (carried, rest) if apart.upper_carries else (rest, carried)
    return near, tuple(
        share[np.argsort(order)] for share, order in zip(ordered, (first, second), strict=True)
    )


def lower_base(parameters: Parameters, lower_m: float) -> Parameters:
    """The parameters with the level or the given plane lower by so much."""
    v = parameters.volume
    plane = (v.plane[0] - lower_m, *v.plane[1:])
    volume = dataclasses.replace(v, level_m=v.level_m - lower_m, plane=plane)
    return dataclasses.replace(parameters, volume=volume)


def volume_difference(a: CloudVolume, b: CloudVolume) -> CloudVolume:
    """One volume less another, of surfaces that share no error."""
    return CloudVolume(
        a.cut_m3 - b.cut_m3,
        a.fill_m3 - b.fill_m3,
        a.cut_raw_m3 - b.cut_raw_m3,
        a.fill_raw_m3 - b.fill_raw_m3,
        a.folded_m3 - b.folded_m3,
        a.near_area_m2 + b.near_area_m2,
        math.hypot(a.sigma_m3, b.sigma_m3),
        math.hypot(a.sigma_cut_m3, b.sigma_cut_m3),
        math.hypot(a.sigma_fill_m3, b.sigma_fill_m3),
        a.area_m2,
        f"{a.base}, each surface over its own footprint",
        False,
        {key: a.budget_m6[key] + b.budget_m6[key] for key in a.budget_m6},
    )


def difference_of_footprints(
    one: CloudSurface,
    two: CloudSurface,
    parameters: Parameters,
    correct: bool = True,
    offset_m: float = 0.0,
) -> tuple[CloudVolume, CloudVolume, CloudVolume]:
    """The published way (seed 000 chapter 5): each surface above the same level over its own
    footprint. Their difference, and both.

    offset_m : by which the first surface lies above the second where nothing changed; the second's
    level is lower by it. Where the footprints differ, their difference times the distance to the
    level is in the result.
    """
    if parameters.volume.base == "ground":
        raise VolumeError(
            "own footprints are compared above a level or a given plane", reason="volume_base"
        )
    (a, _, _), (b, _, _) = (
        above_base(one, parameters, correct),
        above_base(two, lower_base(parameters, offset_m), correct),
    )
    return volume_difference(a, b), a, b

"""What changed between two point clouds of one place: the volume with its verdict, the map of the
level of detection, and the volumes above it.

A bare cloud tells its noise. What else two surveys differ by, as registration, calibration and
navigation, is told where nothing changed: by how far means of cells lie apart there
(:func:`~ladar_volume.clouds.sampling.pair_registration.unchanged_cells`). It enters the level of
detection, and the sigma of thresholded volumes.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from ladar_volume.change.change_detection import (
    ChangeMap,
    ThresholdedVolumes,
    map_of_difference,
    threshold_volumes,
)
from ladar_volume.change.epoch_change import within_outline
from ladar_volume.change.stable_ground import StableGround, area, check_overlap, coverage_doubts
from ladar_volume.change.surface_difference import Difference, difference
from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.clouds.cloud_volume import CloudVolume, between_clouds
from ladar_volume.clouds.epochs.cloud_registration import Registration
from ladar_volume.clouds.pair_verdict import PairGround, named_part, pair_ground, pair_verdict
from ladar_volume.clouds.sampling.pair_registration import ALIKE, CELLS, CHANCE, UnchangedPart
from ladar_volume.clouds.survey.flight_errors import vertex_slopes
from ladar_volume.clouds.volume_verdict import (
    apart_doubts,
    counted_areas,
    surface_doubts,
    with_lines,
)
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Verdict
from ladar_volume.registration.transform import Transform


@dataclass(frozen=True)
class CloudChange:
    """volume : later minus earlier · verdict · change : the map · kept : volumes above the level of
    detection · ground : where the clouds are alike, as a share of what both saw
    """

    volume: CloudVolume
    verdict: Verdict
    change: ChangeMap
    kept: ThresholdedVolumes
    ground: StableGround


@dataclass(frozen=True)
class Pair:
    """Two surfaces compared. new, previous : the later and the earlier one · apart : their
    difference · unchanged : where they are alike · moved : the transform that the later one has
    gone through
    """

    new: CloudSurface
    previous: CloudSurface
    apart: Difference
    unchanged: UnchangedPart | None
    moved: Transform | None

    @property
    def own(self) -> CloudSurface:
        """The surface that carries the difference."""
        return self.new if self.apart.upper_carries else self.previous

    @property
    def other(self) -> CloudSurface:
        """The surface that is interpolated."""
        return self.previous if self.apart.upper_carries else self.new

    @property
    def rough_m(self) -> float:
        """What the surfaces differ by where nothing changed, m: the scatter of cells, and their
        offset where it is beyond chance.
        """
        found = self.unchanged
        if found is None:
            return 0.0
        beyond = abs(found.offset_m) > CHANCE * found.sigma_m
        return math.hypot(found.scatter_m, found.offset_m if beyond else 0.0)

    def noise(self) -> F64:
        """Standard deviations (n,) m of the differences from the noise of both clouds."""
        at = self.apart
        other = self.other.vertex_variance[at.corner]
        out: F64 = np.sqrt(self.own.vertex_variance + (at.weight**2 * other).sum(axis=1))
        return out

    def by_transform(self) -> F64:
        """Derivatives (n, 7) of the differences by the parameters of the transform."""
        if self.moved is None:
            return np.zeros((len(self.apart.tin.vertices), 7))
        tin = self.own.representation.tin
        slope = vertex_slopes(tin)
        lift = np.column_stack([-slope, np.ones(len(slope))])
        source = self.moved.apply_inverse(tin.vertices)
        out: F64 = np.einsum("ni,nik->nk", lift, self.moved.jacobian(source))
        return out

    def sigma_of(self, weight: F64) -> float:
        """Standard deviation, m³, of ``Σ weight_i difference_i`` with weights (n,) m²."""
        at = self.apart
        n = len(self.other.representation.tin.vertices)
        through = np.bincount(at.corner.ravel(), (weight[:, None] * at.weight).ravel(), n)
        variance = float(weight**2 @ self.own.vertex_variance)
        variance += float(through**2 @ self.other.vertex_variance)
        if self.unchanged is not None:
            cell_m2 = area(at.tin) / CELLS
            variance += self.unchanged.scatter_m**2 * ALIKE * cell_m2 * float(np.abs(weight).sum())
        if self.moved is not None:
            j = weight @ self.by_transform()
            variance += float(j @ self.moved.C @ j)
        return math.sqrt(variance)


def change_map_of(pair: Pair, coverage_factor: float) -> ChangeMap:
    """The level of detection of a pair."""
    j = pair.by_transform()
    C = np.zeros((7, 7)) if pair.moved is None else pair.moved.C
    shared = np.sqrt(pair.rough_m**2 + np.maximum(np.einsum("ni,ij,nj->n", j, C, j), 0.0))
    tin = pair.own.representation.tin
    return map_of_difference(pair.apart, tin, pair.noise(), shared, coverage_factor)


def restrict(surface: CloudSurface, polygon: F64 | None) -> CloudSurface:
    """A surface of which only what lies within a polygon (c, 2) m counts."""
    if polygon is None:
        return surface
    made = surface.representation
    tin = within_outline(made.tin, polygon)
    return dataclasses.replace(surface, representation=dataclasses.replace(made, tin=tin))


def pair_ground_of(
    surfaces: list[CloudSurface], stable: F64 | None
) -> tuple[PairGround | None, UnchangedPart | None]:
    """What two surfaces say of one another; stable : (c, 2) m, corners of ground that did not
    change, or None. Raises :class:`VolumeError` (epochs_stable) where both saw too little of it.
    """
    ground = pair_ground(surfaces)
    if ground is None:
        return None, None
    if stable is None:
        return ground, ground.unchanged
    part = named_part(ground, stable)
    return dataclasses.replace(ground, unchanged=part), part


def cloud_change(
    new: CloudSurface,
    previous: CloudSurface,
    name: str,
    coverage_factor: float,
    polygon: F64 | None = None,
    stable: F64 | None = None,
    registration: Registration | None = None,
) -> CloudChange:
    """The later surface minus the earlier one, called ``name``, over what both saw (within a
    polygon (c, 2) m, where given). stable : (c, 2) m, as in :func:`pair_ground_of`. Raises
    :class:`VolumeError` where the noise of one is not known, or they have too little in common.
    """
    if new.sigma_m is None or previous.sigma_m is None:
        words = "without the noise of both there is no level of detection: give --sigma"
        raise VolumeError(words, reason="epochs_noise")
    whole, moved = new, None if registration is None else registration.transform
    new = restrict(new, polygon)
    surfaces = [new, previous]
    volume = between_clouds(new, previous, name)
    apart = difference(new.representation.tin, previous.representation.tin)
    ground, unchanged = pair_ground_of([whole, previous], stable)
    pair = Pair(new, previous, apart, unchanged, moved)
    areas = [counted_areas(s, s.representation.tin.relevant) for s in surfaces]
    if ground is not None and polygon is not None:
        found = pair_ground(surfaces)
        ground = None if found is None else dataclasses.replace(found, unchanged=ground.unchanged)
    verdict = Verdict(() if registration is None else registration.doubts)
    for surface, each in zip(surfaces, areas, strict=True):
        if surface.given_faces is None:
            verdict += Verdict(tuple(surface_doubts(surface, each)))
    volume, more = pair_verdict(volume, surfaces, areas, ground)
    if moved is not None:
        j = common_area(apart) @ pair.by_transform()
        volume = with_lines(volume, {"transform": float(j @ moved.C @ j)})
    stands = stable_share(pair, area(previous.representation.tin), stable is not None)
    verdict += more + Verdict((*coverage_doubts(stands), *apart_doubts(volume)))
    change = change_map_of(pair, coverage_factor)
    kept = threshold_volumes(change, coverage_factor, pair.sigma_of)
    return CloudChange(volume, verdict, change, kept, stands)


def common_area(apart: Difference) -> F64:
    """What each vertex (n,) of a difference stands for, m²."""
    zero = np.zeros(len(apart.tin.vertices))
    return map_of_difference(apart, apart.tin, zero, zero, 1.0).area_m2


def stable_share(pair: Pair, previous_m2: float, named: bool) -> StableGround:
    """The unchanged part as a share of what both saw. Raises :class:`VolumeError` (epochs_overlap)
    for next to nothing.
    """
    common, own = area(pair.apart.tin), area(pair.new.representation.tin)
    overlap = common / max(min(own, previous_m2), 1e-300)
    check_overlap(common, overlap)
    found = pair.unchanged
    offset, sigma, share = (0.0, math.inf, 0.0)
    if found is not None:
        offset, sigma, share = found.offset_m, found.sigma_m, found.share
    return StableGround(offset, sigma, share, named, overlap, common)

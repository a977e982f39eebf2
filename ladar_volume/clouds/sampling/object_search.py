"""Points of a cloud that stand on its surface, found among points that lie in one process or in
tiles.

A dense cloud has points on the faces of a thing, so that no single edge is a step: it is thinned
for the search to one point a cell as wide as a step is high. What the thinned surface shows is then
looked up in the whole: points beside such a part, and well above the surface that is left.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from scipy.spatial import cKDTree

from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import F64, I64, Bool, StandingObject, Tin
from ladar_volume.tin.duplicates import places_and_rows
from ladar_volume.tin.full_tin import build_tin
from ladar_volume.tin.sampled_area import sampled_without_isolated
from ladar_volume.volume.field_checks.standing_objects import (
    APART_M,
    AROUND_M,
    clumps,
    objects_of,
    rise_above,
)

Objects = tuple[StandingObject, ...]
#: Steps are so many times as high as the least body, and than so many standard deviations of one
#: height.
STEP, CLEAR = 5.0 / 3.0, 8.0
#: Points beside a part that stands are of it where they are above the surface that is left by this
#: share of a step.
HIGHER = 0.5
#: Edges that join reach over so many spacings.
REACH = 4.0
#: Points nearer than so many spacings are of one thing; the surface around it reaches over so many
#: of these distances.
APART, AROUND = 2.0, 4.0
#: Rounds: what leans on a thing is seen when that is gone.
ROUNDS = 3


class Located(NamedTuple):
    """Some points of a cloud: their rows (k,), ascending, and where they are, (k, 3) m."""

    rows: I64
    places: F64


class Ring(NamedTuple):
    """Vertices (k,) of a thinned surface: where, which of them stand on it, and which are of
    triangles that count.
    """

    located: Located
    standing: Bool
    counted: Bool


class ThinSurface(Protocol):
    """A surface that was thinned, with something that stands on it."""

    @property
    def standing(self) -> Located:
        """The vertices that stand on it."""
        ...

    def around(self, there: F64, cell_m: float) -> Ring:
        """The vertices in or beside the cells that places ``there`` (m, 2) m lie in."""
        ...


@dataclass(frozen=True)
class ObjectSearch:
    """How what stands on a surface is searched for. sigma_m : of one height · spacing_m : of the
    points, in the median · parameters : of the surface
    """

    sigma_m: float
    spacing_m: float
    parameters: Parameters

    @property
    def step_m(self) -> float:
        """How high a step is, m."""
        return step_height(self.parameters.volume.object_height_m, self.sigma_m)

    @property
    def thinned_m(self) -> float:
        """The cells, m, to one point of which the cloud is thinned: 0 where its points lie farther
        apart.
        """
        return self.step_m if self.spacing_m < self.step_m else 0.0

    @property
    def beside_m(self) -> float:
        """The cells, m, in or beside which a thing's points are."""
        return max(self.step_m, self.spacing_m)

    @property
    def with_reach(self) -> Parameters:
        """The parameters, where edges join over some spacings at least."""
        volume = self.parameters.volume
        longest = max(volume.max_edge_m, REACH * self.spacing_m)
        return dataclasses.replace(
            self.parameters, volume=dataclasses.replace(volume, max_edge_m=longest)
        )


class SitePoints(Protocol):
    """The points of a cloud."""

    def thin_surface(self, how: ObjectSearch) -> ThinSurface | None:
        """Their surface, thinned; None where nothing stands on it. Raises :class:`GroundError`,
        :class:`SurfaceError` or :class:`VolumeError` where there is none.
        """
        ...

    def beside(self, there: F64, cell_m: float) -> Located:
        """Those in or beside the cells that places ``there`` (m, 2) m lie in."""
        ...

    def without(self, things: Located) -> Self:
        """The others."""
        ...


P = TypeVar("P", bound=SitePoints)


@dataclass(frozen=True)
class Found(Generic[P]):
    """points : that belong to the surface · objects : that the others are of, the largest first"""

    points: P
    objects: Objects


def step_height(object_height_m: float, sigma_m: float) -> float:
    """How high a step is, m, for the least rise of a body and the noise of one height."""
    return max(STEP * object_height_m, CLEAR * sigma_m)


def tin_of(points: Located) -> Tin:
    """The surface of points, at the mean height of those with one footprint; ``source`` has the
    first row of each.
    """
    tin = build_tin(points.places)
    if tin.duplicates:
        found, rows = places_and_rows(points.places, points.rows)
        order = np.argsort(rows)
        points = Located(rows[order], found[order, :3])
        tin = build_tin(points.places)
    return dataclasses.replace(tin, source=points.rows[tin.source])


def sampled_tin(points: Located) -> Tin:
    """The same without those that stand alone."""
    return sampled_without_isolated(tin_of(points))[0]


def standing_points(points: SitePoints, thin: ThinSurface, how: ObjectSearch) -> Located:
    """The points that belong to what stands on a thinned surface: its vertices, and what is beside
    them and above the surface of the others around.
    """
    standing = thin.standing
    near = points.beside(standing.places[:, :2], how.beside_m)
    ring = thin.around(near.places[:, :2], AROUND_M)
    left = ring.located.places[~ring.standing]
    high = rise_above(near.places, left) > HIGHER * how.step_m
    rows = np.concatenate([standing.rows, near.rows[high]])
    places = np.concatenate([standing.places, near.places[high]])
    rows, first = np.unique(rows, return_index=True)
    return Located(rows, places[first])


def objects_of_points(
    points: SitePoints, taken: Located, thin: ThinSurface, spacing_m: float
) -> Objects:
    """What the points ``taken`` were of, above all others around; on the thinned surface where the
    points around are too few for one.
    """
    apart = max(APART_M, APART * spacing_m)
    standing, width = thin.standing, AROUND * apart
    ring = thin.around(taken.places[:, :2], width)
    label, at_counted = clumps(standing.places[:, :2], apart), ring.located.rows[ring.counted]
    try:
        tin = sampled_tin(points.beside(taken.places[:, :2], width))
        own = np.isin(tin.source, taken.rows)
    except SurfaceError:
        own = np.zeros(0, np.bool_)
    if not own.any():
        tin = tin_of(ring.located)
        own = np.isin(tin.source, standing.rows)
    # dense points have too many neighbours for pairs of them
    near = cKDTree(standing.places[:, :2]).query(tin.vertices[own, :2])[1]
    return objects_of(tin, own, own, np.isin(tin.source, at_counted), label[near])


def searched(points: P, how: ObjectSearch) -> Found[P]:
    """The points that belong to a surface, and what stands on it."""
    found = list[StandingObject]()
    for _ in range(ROUNDS):
        try:
            thin = points.thin_surface(how)
            if thin is None:
                break
            taken = standing_points(points, thin, how)
            found += objects_of_points(points, taken, thin, how.spacing_m)
        except (GroundError, SurfaceError, VolumeError):  # no ground: the volume will say so
            break
        points = points.without(taken)
    return Found(points, tuple(sorted(found, key=lambda one: -one.volume_m3)))

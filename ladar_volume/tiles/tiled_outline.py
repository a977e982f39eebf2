"""Ground and outline of all tiles, which define each other: :mod:`ladar_volume.volume.base` to what
one process gives.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from scipy import sparse

from ladar_volume.model.errors import GroundError, VolumeError
from ladar_volume.model.parameters import Parameters, VolumeParameters
from ladar_volume.model.records import I64, Bool, Plane
from ladar_volume.tiles import tile_outline
from ladar_volume.tiles.tile_batches import ask
from ladar_volume.tiles.tile_outline import Box, TileParts
from ladar_volume.tiles.tile_store import Tile, digest
from ladar_volume.tiles.tile_surface import surface_folder
from ladar_volume.tiles.tiled_ground import GroundFitter, TiledFit
from ladar_volume.volume.base import LAST, MAX_ROUNDS
from ladar_volume.volume.outline import words_of_pit

R = TypeVar("R")


@dataclass(frozen=True)
class TiledOutline:
    """fit : the ground · folder : where the triangles inside are at rest, None where all that count
    are · parts : of each tile, that rise above the ground · boxes : of what is inside in each tile,
    None for nothing
    """

    fit: TiledFit
    folder: Path | None
    parts: Sequence[TileParts] = ()
    boxes: Sequence[Box | None] = ()


class Inside(NamedTuple):
    """folder : of an outline · name : a digest of which triangles are inside · parts, boxes : as in
    :class:`TiledOutline`
    """

    folder: Path
    name: str
    parts: Sequence[TileParts]
    boxes: Sequence[Box | None]


@dataclass(frozen=True)
class OutlineFinder:
    """Finds bodies, what is around them, and the ground there."""

    fitter: GroundFitter
    parameters: Parameters
    reach: Sequence[Box]

    def found(self) -> TiledOutline:
        """:func:`~ladar_volume.volume.base.base_and_outline` above the ground."""
        p, ground = self.parameters.volume, self.parameters.ground
        fit = self.fitter.start(ground, p.object_height_m / 2)
        if p.outline == "all":
            return TiledOutline(fit, None)
        found = self._inside(fit)
        seen = [found]
        for _ in range(MAX_ROUNDS):
            self._ring(found.folder, found.boxes)
            fit = self._around(fit, found.folder)
            found = self._inside(fit)
            again = [k for k, earlier in enumerate(seen) if earlier.name == found.name]
            if again:
                seen = seen[again[0] + 1 :]
                break
            seen.append(found)
        self._ring(found.folder, found.boxes)
        others = [one.folder for one in seen[-LAST:] if one.name != found.name]
        moved = [self._between(fit.plane, one, found.folder) for one in others]
        plane = dataclasses.replace(fit.plane, unsettled_m3=max(moved, default=0.0))
        fit = dataclasses.replace(fit, plane=plane)
        return TiledOutline(fit, found.folder, found.parts, found.boxes)

    def _between(self, base: Plane, one: Path, two: Path) -> float:
        """Net volume above a base, m³, by which two outlines differ."""
        n = len(self.fitter.of.tiles)
        return abs(sum(self._ask(tile_outline.volume_between, [(base, one, two)] * n)))

    def _around(self, fit: TiledFit, folder: Path) -> TiledFit:
        """The ground around an outline."""
        p = self.parameters
        try:
            ring = folder / "ring"
            return self.fitter.refine(fit.plane, p.volume.object_height_m, ring, p.ground)
        except GroundError as error:
            if error.reason != "ground_too_few_points":
                raise
            words = (
                "no ground is left around what rises above it: the body takes up the survey; take "
                "more of its surroundings, or give --level or --plane"
            )
            raise GroundError(words, reason="ground_none_around", value=0) from error

    def _ask(self, op: Callable[..., R], more: Sequence[tuple[object, ...]]) -> list[R]:
        return ask(self.fitter.workers, self.fitter.of, op, more)

    def _inside(self, fit: TiledFit) -> Inside:
        """The outline above a ground."""
        p, tiles = self.parameters.volume, self.fitter.of.tiles
        asked = [p.object_height_m, p.bodies, p.min_body_m3, p.outline_margin_m, p.ground_ring_m]
        plane: Plane = fit.plane
        words = [asked, plane.beta.tolist(), plane.origin_xy.tolist()]
        folder = surface_folder(self.fitter.of.index, self.fitter.of.limits) / digest(words)
        n = len(tiles)
        rising = self._ask(tile_outline.rising_parts, [(folder, plane, p.object_height_m)] * n)
        if not any(parts.count for parts in rising):
            raise self._nothing_rises(plane)
        chosen = self._bodies(rising)
        boxes = self._ask(tile_outline.body, [(folder, c) for c in chosen])
        beside = self.beside(boxes, p.outline_margin_m)
        grown = [
            (folder, c, some, p.outline_margin_m) for c, some in zip(chosen, beside, strict=True)
        ]
        rest = self._ask(tile_outline.grow, grown)
        found = self._ask(tile_outline.fill, [(folder, holes) for holes in enclosed_parts(rest)])
        name = hashlib.sha256(b"".join(name for _, name in found)).hexdigest()
        return Inside(folder, name, rising, [box for box, _ in found])

    def _bodies(self, rising: Sequence[TileParts]) -> list[Bool]:
        """Which parts (count,) of each tile belong to the bodies."""
        return [body >= 0 for body in bodies_in_order(rising, self.parameters.volume)]

    def _nothing_rises(self, base: Plane) -> VolumeError:
        """The error that says so, and what lies below the base instead."""
        height_m = self.parameters.volume.object_height_m
        pits = self._ask(tile_outline.pit, [(base, height_m)] * len(self.fitter.of.tiles))
        area = sum(one.area_m2 for one in pits)
        words = f"nothing rises more than {height_m:g} m above the base"
        if area > 0.0:
            x, y = np.sum([one.first_m3 for one in pits], axis=0) / area
            words += words_of_pit(area, max(one.depth_m for one in pits), x, y)
        return VolumeError(words, reason="volume_no_body", value=height_m)

    def beside(self, boxes: Sequence[Box | None], distance_m: float) -> list[list[Tile]]:
        """For each tile those with something in a box that its triangles may reach."""
        tiles = self.fitter.of.tiles
        some = [(tile, box) for tile, box in zip(tiles, boxes, strict=True) if box is not None]
        d = 1.001 * distance_m + 1e-6
        return [
            [
                tile
                for tile, (x0, y0, x1, y1) in some
                if x0 - d <= own[2] and x1 + d >= own[0] and y0 - d <= own[3] and y1 + d >= own[1]
            ]
            for own in self.reach
        ]

    def _ring(self, folder: Path, boxes: Sequence[Box | None]) -> None:
        """The vertices around an outline, at rest."""
        ring_m = self.parameters.volume.ground_ring_m
        beside = self.beside(boxes, ring_m)
        self._ask(tile_outline.ring_vertices, [(folder, some, ring_m) for some in beside])


def bodies_in_order(rising: Sequence[TileParts], p: VolumeParameters) -> list[I64]:
    """Which body each part (count,) of each tile belongs to, the largest being 0; -1 for none of
    those that count.
    """
    label = part_labels(rising)
    total = np.bincount(label, np.concatenate([each.total for each in rising]))
    order = np.argsort(-total, kind="stable")
    kept = [k for n, k in enumerate(order) if n == 0 or total[k] >= max(p.min_body_m3, 1e-300)]
    kept = kept[: p.bodies] if p.bodies else kept
    body = np.full(len(total), -1, np.int64)
    body[kept] = np.arange(len(kept))
    return np.split(body[label], np.cumsum([each.count for each in rising])[:-1])


def part_labels(parts: Sequence[TileParts]) -> I64:
    """Numbers (k,) of the parts of all tiles, one after the other, the same for those that are
    joined: they have a triangle in common.
    """
    first = np.r_[0, np.cumsum([each.count for each in parts])]
    corners = np.concatenate([each.corners for each in parts])
    label = np.concatenate([at + each.label for at, each in zip(first[:-1], parts, strict=True)])
    if not len(corners):
        return np.arange(first[-1])
    one = np.unique(corners, axis=0, return_inverse=True)[1].reshape(-1)
    order = np.argsort(one, kind="stable")
    same = np.flatnonzero(np.diff(one[order]) == 0)
    a, b = label[order[same]], label[order[same + 1]]
    links = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(first[-1], first[-1]))
    return np.asarray(sparse.csgraph.connected_components(links, directed=False)[1], np.int64)


def enclosed_parts(parts: Sequence[TileParts]) -> list[Bool]:
    """Which parts (count,) of each tile lead nowhere, with all that they are joined to."""
    label = part_labels(parts)
    leads = np.bincount(label, np.concatenate([each.total for each in parts]), minlength=1) > 0
    holes = ~leads[label] if len(label) else np.zeros(0, np.bool_)
    return np.split(holes, np.cumsum([each.count for each in parts])[:-1])

"""What speaks against a body above the ground of all tiles: its toe, the edge of the survey, what
stands beside it, the sides on which there is no ground, and what grows on that.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ladar_volume.clouds.cloud_noise import FEWEST, fit_residuals, robust_sigma
from ladar_volume.clouds.cloud_volume import CloudVolume
from ladar_volume.clouds.ground_cover import MOST, growth_by_sectors
from ladar_volume.clouds.sampling.thin_toe import Outline, beyond_profile, step_of
from ladar_volume.clouds.volume_verdict import with_growth_of, with_lines
from ladar_volume.ground.heights import height_above
from ladar_volume.model.parameters import VolumeParameters
from ladar_volume.model.records import F64
from ladar_volume.model.verdict import Doubt
from ladar_volume.tiles.readings import tile_body, tile_outside
from ladar_volume.tiles.readings.tile_body import BodyTask, JudgedBody, judged_body
from ladar_volume.tiles.readings.tiled_readings import Around
from ladar_volume.tiles.tile_batches import ask
from ladar_volume.tiles.tile_work import each_result
from ladar_volume.tiles.tiled_ground import GroundFitter
from ladar_volume.tiles.tiled_outline import part_labels
from ladar_volume.tiles.unseen.tiled_layers import near_places
from ladar_volume.volume.field_checks.completeness import further_doubts, one_sided_doubts
from ladar_volume.volume.field_checks.standing_objects import AROUND_M


class Edge(NamedTuple):
    """toe_m3 : what a thin toe holds beyond the outline · open_share : of the outline, on the edge
    of what was sampled · centre : (2,) m, of the vertices inside
    """

    toe_m3: float
    open_share: float
    centre: F64


def edge_of(around: Around) -> Edge:
    """What the edge of the outline is."""
    outline = around.found.folder
    found = around.each(tile_outside.border_sides, outline)
    sides = np.concatenate([ends for ends, _ in found])
    closed, beyond, area = np.sum([facts for _, facts in found], axis=0).tolist()
    name = "inside_vertices"
    inside = around.sums(tile_outside.inside_vertices, around.region, -math.inf, name)
    count = int(inside[0])
    xyz = around.every(name, count, step_of(count))
    line = Outline(sides[:, :2], sides[:, 2:], closed, area)
    height = height_above(xyz, around.found.fit.plane)
    toe = beyond_profile(line, xyz[:, :2], height)
    share = beyond / (closed + beyond) if closed + beyond > 0.0 else 0.0
    return Edge(toe, share, inside[1:] / count)


def with_edge(volume: CloudVolume, edge: Edge) -> CloudVolume:
    """The volume with what its toe holds beyond the outline."""
    return with_lines(volume, {"toe": edge.toe_m3**2}) if edge.toe_m3**2 > 0.0 else volume


def completeness(
    around: Around,
    volume: CloudVolume,
    scatter_m: float,
    centre: F64,
    objects: Sequence[Doubt],
) -> JudgedBody:
    """Whether the body is cut, whether walls or further bodies stand by, and whether the ground is
    on one side only. scatter_m : of its points · centre : (2,) m, of its vertices · objects :
    doubts about what stood on it
    """
    v, judged = around.finder.parameters.volume, JudgedBody([], {})
    boxes = around.found.boxes
    beside, of = around.finder.beside(boxes, AROUND_M), around.fitter.of
    more = [(around.region, some) for some in beside]
    counts = ask(around.fitter.workers, of, tile_body.body_and_around, more)
    if (count := sum(counts)) > tile_body.MOST_OF_BODY:
        words = (
            f"whether the body is cut, and whether walls stand in it, is not told of {count:,}"
            f" points, more than {tile_body.MOST_OF_BODY:,}: look at it, or hold a part of the "
            "cloud against ladar_volume volume"
        )
        judged.doubts.append(Doubt("tiles_not_judged", words, float(count)))
    else:
        tiles = [tile for tile, n in zip(of.tiles, counts, strict=True) if n]
        size = abs(volume.cut_m3 - volume.fill_m3)
        scatter = 0.0 if math.isnan(scatter_m) else scatter_m
        parameters = around.finder.parameters
        sizes = volume.sigma_m3, size, scatter
        task = BodyTask(around.region, tiles, parameters, *sizes, objects)
        (judged,) = each_result(around.fitter.workers, partial(judged_body, of), [task])
    further = [] if v.bodies == 0 else further_bodies(around, v, volume.sigma_m3)
    return JudgedBody([*judged.doubts, *further, *one_sided(around, centre)], judged.lines)


def further_bodies(around: Around, v: VolumeParameters, sigma_m3: float) -> list[Doubt]:
    """Other bodies stand beside those that count."""
    parts = around.found.parts
    label = part_labels(parts)
    total = np.bincount(label, np.concatenate([p.total for p in parts]))
    more = [(around.region, p.count) for p in parts]
    each = ask(around.fitter.workers, around.fitter.of, tile_outside.bodies_beside, more)
    sums = np.zeros((len(total), 4))
    np.add.at(sums, label, np.concatenate(each))
    order = np.argsort(-total, kind="stable")
    found = [
        (float(sums[k, 0]), *(sums[k, 2:] / sums[k, 1]).tolist())
        for n, k in enumerate(order.tolist())
        if (n == 0 or (total[k] > 0 and total[k] >= v.min_body_m3))
        and sums[k, 1] > 0
        and sums[k, 0] >= max(v.min_body_m3, sigma_m3)
    ]
    return further_doubts(found, v.object_height_m)


def one_sided(around: Around, centre: F64) -> list[Doubt]:
    """The ground lies on one side only of a centre (2,) m."""
    chosen = around.found.fit.chosen
    return one_sided_doubts(around.sums(tile_outside.support_directions, chosen, centre))


class Scatter(NamedTuple):
    """centre : (2,) m, of the body's vertices · scatter_m : of its points about local quadrics"""

    centre: F64
    scatter_m: float


def body_scatter(around: Around, rise_m: float) -> Scatter:
    """How the points of the body scatter; NaN where they are too few."""
    name = "high_vertices"
    facts = around.sums(tile_outside.inside_vertices, around.region, rise_m, name)
    count, centre = int(facts[0]), facts[1:] / max(facts[0], 1.0)
    if count < FEWEST:
        return Scatter(centre, math.nan)
    return Scatter(
        centre, robust_sigma(scatter_at(around.fitter, around.some(name, count, MOST)), 0.0)
    )


def with_growth(
    around: Around, volume: CloudVolume, body: Scatter
) -> tuple[CloudVolume, list[Doubt]]:
    """The volume with what grows on the ground around the body."""
    n = around.found.fit.count
    if n < FEWEST or math.isnan(body.scatter_m):
        return volume, []
    step = max(1, math.ceil(n / MOST))
    low = around.fitter.at_ranks(around.region.chosen, n, step)[:, 1:4]
    off = scatter_at(around.fitter, low)
    grown = growth_by_sectors(low[:, :2] - body.centre, off, body.scatter_m)
    return with_growth_of(volume, grown)


def scatter_at(fitter: GroundFitter, places: F64) -> F64:
    """What local quadrics miss points (k, 3) m by, m."""
    near, own, order = near_places(fitter, places)
    out = np.empty(len(places))
    out[order] = fit_residuals(own, near, np.arange(len(own)))[0]
    return np.where(np.isfinite(out), out, 0.0)

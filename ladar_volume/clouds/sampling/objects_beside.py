"""What was taken out of a cloud because it stands on its surface: what of it is of an outline, and
what is beside it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ladar_volume.clouds.cloud_surface import CloudSurface
from ladar_volume.model.records import F64, StandingObject
from ladar_volume.model.verdict import Doubt

#: Things beside the body that are this share of it may be heaps.
LARGE = 0.2
#: A thing is of an outline that comes as near to its middle as this share of its size.
REACH = 0.5


def objects_within(surface: CloudSurface, inside: F64) -> tuple[StandingObject, ...]:
    """What was taken out where triangles of area inside (m,) m² count, or beside them."""
    if not surface.objects:
        return ()
    tin, rows = surface.representation.tin, np.flatnonzero(inside > 0.0)
    middle = tin.vertices[tin.triangles[rows], :2].mean(axis=1)
    out = []
    for one in surface.objects:
        away = np.hypot(*(middle - (one.x_m, one.y_m)).T).min(initial=np.inf)
        if away <= REACH * one.size_m:
            out.append(dataclasses.replace(one, inside=True))
    return tuple(out)


def beside_doubts(
    objects: Sequence[StandingObject],
    within: Sequence[StandingObject],
    sizes_m3: tuple[float, float],
) -> list[Doubt]:
    """What stands beside an outline, not ``within`` it, and is as large as a further body and a
    good part of the volume, is not in it: an upright heap looks like a machine. sizes_m3 : of the
    least further body, and of what counts
    """
    least_m3 = max(sizes_m3[0], LARGE * abs(sizes_m3[1]))
    own = {(one.x_m, one.y_m) for one in within}
    away = [one for one in objects if (one.x_m, one.y_m) not in own and one.volume_m3 >= least_m3]
    if not away:
        return []
    one = max(away, key=lambda each: each.volume_m3)
    several = f"{len(away)} things stand" if len(away) > 1 else "something stands"
    words = (
        f"{several} on steep faces beside what counts and {'are' if len(away) > 1 else 'is'} not "
        f"in the volume, the largest of {one.volume_m3:.3g} m³, {one.size_m:.2g} m wide and "
        f"{one.high_m:.2g} m high, at ({one.x_m:.1f}, {one.y_m:.1f}) m; where it is a heap, set "
        "volume.objects to count and volume.bodies to 0, or draw an outline around it"
    )
    return [Doubt("further_bodies", words, sum(each.volume_m3 for each in away))]

"""What the choice of vertices and diagonals adds to sigma, where it follows the noise more than
sigma knows: the same points as the usual surface make another volume.

Exchanged diagonals and vertices by ``residual-sigma`` are chosen by the noise of the points.
Derivatives hold them fixed. The usual surface (``residual-area``, Delaunay) of the same points has
no part in that choice, and its scatter is in sigma: what the two volumes differ by is a line of its
own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from ladar_volume.model.errors import GroundError, SurfaceError, VolumeError
from ladar_volume.model.parameters import Parameters
from ladar_volume.model.records import Volume
from ladar_volume.model.surface_parameters import TinParameters
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.volume.field_checks.field_verdict import with_line

#: Name of the line.
LINE = "surface_choice"


def follows_noise(options: TinParameters) -> bool:
    """Whether vertices or diagonals are chosen by the noise more than sigma knows."""
    return options.exchange != "none" or options.criterion == "residual-sigma"


def usual_surface(parameters: Parameters) -> Parameters:
    """The parameters with the usual choice of vertices and diagonals."""
    tin = dataclasses.replace(
        parameters.tin, criterion="residual-area", exchange="none", readjust=True
    )
    return dataclasses.replace(parameters, tin=tin)


def with_choice(
    volumes: tuple[Volume, ...],
    options: TinParameters,
    usual: Callable[[], tuple[Volume, ...]],
) -> tuple[Volume, ...]:
    """The volumes with the line. usual : the volumes of the usual surface of the same points."""
    if not follows_noise(options):
        return volumes
    try:
        others = usual()
    except (GroundError, SurfaceError, VolumeError):
        others = ()
    if len(others) == len(volumes):
        return tuple(
            with_line(one, LINE, (one.volume_m3 - other.volume_m3) ** 2)
            for one, other in zip(volumes, others, strict=True)
        )
    words = (
        "sigma takes exchanged diagonals, or the vertices chosen by residual-sigma, for given, "
        "though noise had a part in them, and the usual surface has "
        f"{len(others)} bodies for {len(volumes)}: compare with the default of section tin"
    )
    doubt = Verdict((Doubt("surface_held_fixed", words),))
    return tuple(dataclasses.replace(v, verdict=v.verdict + doubt) for v in volumes)

"""A replayed survey, from the folder of its result, as what files hold."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ladar_volume.georeference.geodesy import LocalFrame
from ladar_volume.ground.heights import height_above
from ladar_volume.io.export.deliverable import (
    Deliverable,
    SurfacePoints,
    faces_volume,
    file_facts,
    rows_of,
)
from ladar_volume.io.export.output_system import (
    OutputSystem,
    in_projection,
    local_system,
    plain_words,
    projection,
)
from ladar_volume.io.surveys import SavedSurvey
from ladar_volume.model.errors import InputError
from ladar_volume.model.records import F64, Datum, FilteredPoints
from ladar_volume.uncertainty.volume_budget import vertical_sigma
from ladar_volume.volume.base import polygon_of
from ladar_volume.volume.estimator import VolumeEstimator

#: The volume computed again may differ from that in the result by this part, and by this length
#: over its area: covariances, which weight the ground, are kept to 1e-7.
SAME, SAME_M = 1e-6, 1e-6


def survey_deliverable(
    saved: SavedSurvey, estimator: VolumeEstimator, crs: str | None = None
) -> Deliverable:
    """A saved survey, with the estimator of its surface; in its own east, north, up, or in a
    projected system in metres.

    Raises :class:`InputError` where the surface gives another volume than the result
    (survey_file), and for a system that does not fit (input_crs).
    """
    result = saved.result
    estimate = estimator.estimate(naive=False)
    check_same(saved.path, estimate.volume.volume_m3, result)
    sources = estimator.epoch().sources
    tin, points = estimate.tin, sources.points
    sigma = vertical_sigma(sources, np.arange(len(points)))
    system, at = output_transform(saved.datum, crs)
    own = dataclasses.replace(tin, vertices=at(tin.vertices))
    # heights above the base are kept: the survey's up and the normal of the ellipsoid differ by
    # the angle that the site takes up on the earth
    base_m = own.vertices[:, 2] - height_above(tin.vertices, estimate.base)
    columns = point_columns(points, sigma, crs is None)
    rings: list[F64] = []
    if estimator.parameters.volume.outline == "polygon":
        corners = polygon_of(estimator.parameters.volume)
        rings.append(at(np.column_stack([corners, np.zeros(len(corners))]))[:, :2])
    faces = [faces_volume(own, base_m, part, rings) for part in estimator.footing.parts()]
    return Deliverable(
        name=plain_words(str(result["input"]["path"])),
        tin=own,
        counted=estimator.footing.inside > 0.0,
        base_m=base_m,
        other=None,
        sigma_m=sigma[tin.source],
        covariance=None,
        points=SurfacePoints(at(points.r_map), columns),
        facts={**result, "files": file_facts(faces, system)},
        rows=rows_of(result, result["bodies"] or [result], faces),
        system=system,
        outlines=rings,
    )


def point_columns(points: FilteredPoints, sigma: F64, own_axes: bool) -> dict[str, F64]:
    """Columns (n,) of points; their normals too where the axes are the survey's own."""
    columns = {
        "sigma_z": sigma,
        "sigma_normal": np.sqrt(points.variance),
        "time_unix_s": points.t_ns * 1e-9,
    }
    return columns | ({"normal": points.normal} if own_axes else {})


def check_same(file: Path, volume_m3: float, result: Mapping[str, Any]) -> None:
    """Refuse a surface whose volume is not that of the result. Raises :class:`InputError`."""
    known = float(result["volume_m3"])
    if not abs(volume_m3 - known) <= SAME * abs(known) + SAME_M * float(result["area_m2"]):
        raise InputError(
            f"{file}: its surface gives {volume_m3:.6g} m³, the result says {known:.6g} m³: replay "
            "the recording again with this version",
            reason="survey_file",
            value=volume_m3,
        )


def output_transform(
    datum: Datum | None, crs: str | None
) -> tuple[OutputSystem, Callable[[F64], F64]]:
    """The system of the files, and what brings points (n, 3), m, of the map there. Raises
    :class:`InputError` (input_crs) for a projection of a survey that knows no place on the earth.
    """
    if crs is None:
        return OutputSystem() if datum is None else local_system(datum), lambda r: r
    if datum is None:
        raise InputError(
            "--crs: the survey has no place on the earth (its poses are odometry): leave --crs out",
            reason="input_crs",
            value=crs,
        )
    system, frame = projection(datum, crs), LocalFrame(datum)
    return system, lambda r: in_projection(frame.to_geodetic(r), system)

"""``diff`` of two closed meshes: the difference of their volumes."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from ladar_volume.change.density import relative_errors
from ladar_volume.cli.diff_input import ScanFile
from ladar_volume.mesh.crossed_space import crossing_doubts
from ladar_volume.mesh.tetrahedra import ClosedVolume, closed_variance, closed_volume
from ladar_volume.model.errors import ConfigurationError, SurfaceError
from ladar_volume.model.verdict import Verdict

#: Options of scans, which closed bodies do not take.
OF_SCANS = ("polygon", "selection", "icp", "resolution", "output", "scanner", "scanner_b")


def bodies(arguments: argparse.Namespace, a: ScanFile, b: ScanFile) -> dict[str, Any]:
    """Two closed meshes: the difference of their volumes. Raises :class:`ConfigurationError` for
    options of scans.
    """
    for name in OF_SCANS:
        if getattr(arguments, name) is not None:
            raise ConfigurationError(
                f"--{name.replace('_', '-')} is for scans; these are closed bodies"
            )
    sigmas = arguments.sigma, arguments.sigma if arguments.sigma_b is None else arguments.sigma_b
    budget: dict[str, float] = {}
    verdict = a.verdict + b.verdict
    each: list[ClosedVolume] = []
    for name, file, sigma in zip("ab", (a, b), sigmas, strict=True):
        body = body_of(file, arguments)
        budget |= body_budget(name, file, body, sigma)
        if body.crossing is not None:
            verdict += Verdict(crossing_doubts(body.crossing, body.volume_m3))
        each.append(body)
    volume, sigma_m3 = each[0].volume_m3 - each[1].volume_m3, float(np.sqrt(sum(budget.values())))
    area = 0.0 + each[0].area_m2 + each[1].area_m2
    noise = max(s or 0.0 for s in sigmas)
    return {
        "method": "closed bodies",
        "volume_m3": volume,
        "sigma_m3": sigma_m3,
        "budget_m6": budget,
        "watertight": True,
        "closed_m3": 0.0,
        "interval_m3": [volume - 1.96 * sigma_m3, volume + 1.96 * sigma_m3],
        "coverage_factor": 1.96,
        "area_m2": area,
        "pole_m": each[1].pole_map.tolist(),
        "pole_spread_m3": max(0.0, *(body.pole_spread_m3 for body in each)),
        "bodies": [body_facts(file, body) for file, body in zip((a, b), each, strict=True)],
        "verdict": verdict,
        "size_classes": size_classes(each, volume, area, noise, arguments.offset),
    }


def body_of(file: ScanFile, arguments: argparse.Namespace) -> ClosedVolume:
    """The volume of a closed mesh; errors name its file."""
    try:
        return closed_volume(file.points, file.triangles, arguments.pole, arguments.allow_crossings)
    except SurfaceError as error:
        raise SurfaceError(
            f"{file.path}: {error}", reason=error.reason, value=error.value
        ) from error


def body_budget(
    name: str, file: ScanFile, body: ClosedVolume, sigma: float | None
) -> dict[str, float]:
    """Variances, m⁶, of body ``name`` by its vertices' noise sigma, m, and by its registration."""
    variance = closed_variance(file.points, body, sigma or 0.0)
    noise = np.nan if sigma is None else variance.first_m6 + variance.second_m6
    if file.transform is None:
        return {f"noise_{name}": noise}
    registration = file.transform.variance(body.gradient, file.transform.apply_inverse(file.points))
    return {f"noise_{name}": noise, f"registration_{name}": registration}


def body_facts(file: ScanFile, body: ClosedVolume) -> dict[str, Any]:
    """What the JSON says of one body."""
    return {
        "path": file.path.name,
        "volume_m3": body.volume_m3,
        "area_m2": body.area_m2,
        "parts": len(body.volumes_m3),
        "turned_triangles": int(body.flipped.sum()),
        "crossing_m3": 0.0 if body.crossing is None else body.crossing.volume_m3,
    }


def size_classes(
    each: list[ClosedVolume], volume_m3: float, area_m2: float, noise_m: float, offset_m: float
) -> dict[str, float] | None:
    """Each class of error as a share of the difference; None for a difference of zero."""
    if volume_m3 == 0.0:
        return None
    vertices = sum(body.mesh.vertices for body in each)
    return relative_errors(
        area_m2,
        abs(volume_m3),
        offset_m=offset_m,
        noise_m=noise_m,
        spacing_m=float(np.sqrt(area_m2 / vertices)),
    )

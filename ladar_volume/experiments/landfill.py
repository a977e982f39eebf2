"""``ladar_volume study landfill``: the excavation of seed 003 repeated on simulated scans, three
bodies a seed.

Every step is Kern's (seed 003 sections 2 and 3): reference spheres measured by tacheometer and
scanner, registration of a levelled scanner, regions, triangulation about the scanner, volumes to a
pole, their difference, and density from the weighed mass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ladar_volume.change.density import Density, density, relative_errors, weighed_mass
from ladar_volume.change.excavation import (
    Excavation,
    Region,
    Scan,
    beam_noise,
    by_resolution,
    excavate,
)
from ladar_volume.change.resolution import ResolutionSeries, thin
from ladar_volume.experiments.landfill_scene import (
    LAYERS,
    RANGE_SIGMA_M,
    SPHERE_M,
    TACHEOMETER_SIGMA_M,
    Layer,
    RawScan,
    make_layer,
    scan,
    tacheometer,
)
from ladar_volume.mesh.topology import watertight
from ladar_volume.model.errors import RegistrationError, SimulationError
from ladar_volume.model.records import F64, I64
from ladar_volume.registration.sphere_adjustment import Registration, register
from ladar_volume.registration.spheres import MIN_POINTS, Sphere, fit_sphere

#: Densities of the three layers, kg/m³ (none is printed), and how the material was weighed:
#: lorries, sigma of each, calibration.
DENSITIES_KG_M3 = (900.0, 1150.0, 1400.0)
LOAD_KG, SIGMA_LOAD_KG, SIGMA_CALIBRATION = 4000.0, 20.0, 0.001
#: How far the sphere is off that was knocked over before the second scan, m; which one, and which
#: one a machine hides from each scan.
KNOCKED_M, KNOCKED, HIDDEN = 0.05, 2, (4, 5)
MARGIN_M, RING_M = 0.5, 0.08
#: Noise across the beam that a point on a sphere is given, in sigmas along it. Where the beam only
#: touches, range noise σ leaves the sphere in second order, by σ²/2R in the mean: without this the
#: limb would count too much, and sigma of a centre come out a seventh too small.
ACROSS = 0.2
#: One point per cell of this size serves, m: independent noise is the least part of the budget.
#: Cells of the series over resolution.
THIN_M = 0.02
CELLS_M = (0.015, 0.03, 0.06, 0.12, 0.24)


@dataclass(frozen=True)
class Body:
    """One layer measured: exact volume m³ · excavation · density found and true, kg/m³ · the
    spheres used, of scan A and B, and what each scan's test left out
    """

    true_m3: float
    excavation: Excavation
    rho: Density
    true_kg_m3: float
    used: tuple[list[int], list[int]]

    @property
    def error_pct(self) -> float:
        """Error of the volume, %."""
        return 100.0 * (self.excavation.removed_m3 / self.true_m3 - 1.0)


@dataclass(frozen=True)
class Study:
    """bodies : by seed and layer · resolution : of the second body of seed 0"""

    bodies: list[list[Body]]
    resolution: ResolutionSeries


def fit_spheres(points: F64, number: I64, instrument: F64, sigma_m: float) -> dict[int, Sphere]:
    """The spheres by number, of known radius, from points (k, 3) m seen from an instrument (3,);
    without those of too few points.
    """
    out = {}
    for k in np.unique(number).tolist():
        p = points[number == k]
        if len(p) >= MIN_POINTS:
            out[k] = fit_sphere(
                p,
                beam_noise(p, instrument, sigma_m) + (ACROSS * sigma_m) ** 2 * np.eye(3),
                SPHERE_M,
                instrument,
            )
    return out


def register_scan(raw: RawScan, reference: dict[int, Sphere]) -> tuple[Scan, list[int]]:
    """The scan in the map frame by a levelled transform, and the numbers of the spheres it used."""
    own = fit_spheres(raw.on_spheres, raw.sphere, np.zeros(3), RANGE_SIGMA_M)
    names = sorted(own.keys() & reference.keys())
    sides = [
        (np.array([s[k].centre for k in names]), np.array([s[k].C_centre for k in names]))
        for s in (own, reference)
    ]
    found: Registration = register(
        sides[0][0], sides[1][0], sides[0][1], sides[1][1], levelled=True, scale=1.0
    )
    if not found.consistent:
        raise RegistrationError(
            "the spheres that are left do not agree",
            reason="registration_inconsistent",
            value=names,
        )
    points = found.transform.apply(raw.surface)
    eye = found.transform.apply(np.zeros((1, 3)))[0]
    used = [k for k, u in zip(names, found.used, strict=True) if u]
    return Scan(points, eye, beam_noise(points, eye, RANGE_SIGMA_M), found.transform), used


def scans_of(
    layer: Layer, rng: np.random.Generator
) -> tuple[tuple[Scan, list[int]], tuple[Scan, list[int]]]:
    """Both scans of a layer, registered. Spheres are measured anew for each scan; one is knocked
    over in between, one hidden from each.
    """
    station = np.array([14.0, -9.0, 1.6])
    out = []
    for which, mesh in enumerate((layer.before, layer.after)):
        reference = fit_spheres(
            *tacheometer(layer.spheres, station, rng), station, TACHEOMETER_SIGMA_M
        )
        at = layer.spheres.copy()
        at[KNOCKED] += KNOCKED_M * np.array([0.6, -0.8, 0.0]) * which
        raw = scan(mesh, layer.scanners[which], np.delete(at, HIDDEN[which], axis=0), rng)
        number = raw.sphere + (raw.sphere >= HIDDEN[which])
        if which == 0:  # the operator leaves the sixth out too: four are used
            keep = number != HIDDEN[1]
            raw, number = (
                RawScan(
                    raw.surface,
                    raw.on_spheres[keep],
                    number[keep],
                    raw.heading_rad,
                    raw.scanner_map,
                ),
                number[keep],
            )
        out.append(
            register_scan(
                RawScan(raw.surface, raw.on_spheres, number, raw.heading_rad, raw.scanner_map),
                reference,
            )
        )
    return out[0], out[1]


def registered_scans(number: int, seed: int) -> tuple[Scan, Scan, Region]:
    """Both registered scans of a layer, all their points, and its region."""
    layer = make_layer(number, seed)
    (a, _), (b, _) = scans_of(layer, np.random.default_rng([seed, number, 5]))
    return a, b, Region(layer.polygon, MARGIN_M, RING_M)


def measure(number: int, seed: int) -> Body:
    """One layer of one seed: volume and density."""
    layer, rng = make_layer(number, seed), np.random.default_rng([seed, number, 5])
    (a, used_a), (b, used_b) = scans_of(layer, rng)
    region = Region(layer.polygon, MARGIN_M, RING_M)
    found = excavate(a.part(thin(a.points, THIN_M)), b.part(thin(b.points, THIN_M)), region)
    true_mass = DENSITIES_KG_M3[number] * layer.volume_m3
    count = max(1, round(true_mass / LOAD_KG))
    loads = true_mass / count * (
        1.0 + SIGMA_CALIBRATION * rng.standard_normal()
    ) + SIGMA_LOAD_KG * rng.standard_normal(count)
    mass = weighed_mass(loads, SIGMA_LOAD_KG, SIGMA_CALIBRATION)
    rho = density(mass.mass_kg, mass.sigma_kg, found.removed_m3, found.sigma_m3)
    return Body(layer.volume_m3, found, rho, DENSITIES_KG_M3[number], (used_a, used_b))


def run(seeds: int, progress: Callable[[str], None] = lambda text: None) -> Study:
    """Simulate and measure with seeds 0 to seeds − 1. Raises :class:`SimulationError` for none."""
    if seeds < 1:
        raise SimulationError(f"a study needs one seed or more, not {seeds}", value=seeds)
    bodies: list[list[Body]] = []
    for seed in range(seeds):
        row = []
        for number in range(LAYERS):
            progress(f"seed {seed + 1} of {seeds}, body {number + 1}")
            row.append(measure(number, seed))
        bodies.append(row)
    progress("volume against resolution")
    return Study(bodies, by_resolution(*registered_scans(1, 0), list(CELLS_M)))


def size_shares(body: Body, sigma_m: float = RANGE_SIGMA_M) -> dict[str, float]:
    """Each class of error of this body with 1 cm, as a share of its volume."""
    d = body.excavation.between
    spacing = float(
        np.sqrt(
            (d.area_a_m2 + d.area_b_m2) / (body.excavation.in_a.sum() + body.excavation.in_b.sum())
        )
    )
    return relative_errors(
        body.excavation.area_m2,
        body.true_m3,
        offset_m=sigma_m,
        noise_m=sigma_m,
        spacing_m=spacing,
        height_m=sigma_m,
        plan_area_m2=d.area_a_m2,
    )


def summary(study: Study) -> dict[str, Any]:
    """The numbers of the study as plain values."""
    every = [b for row in study.bodies for b in row]
    error = np.array([b.error_pct for b in every])
    sigma = np.array([100.0 * b.excavation.sigma_m3 / b.true_m3 for b in every])
    normal = np.array(
        [(b.excavation.removed_m3 - b.true_m3) / b.excavation.sigma_m3 for b in every]
    )
    published = np.array([100.0 * (b.excavation.published_m3 / b.true_m3 - 1.0) for b in every])
    rho = np.array([100.0 * (b.rho.density_kg_m3 / b.true_kg_m3 - 1.0) for b in every])
    inside = [b.rho.interval_kg_m3[0] <= b.true_kg_m3 <= b.rho.interval_kg_m3[1] for b in every]
    s = study.resolution
    return {
        "bodies": len(every),
        "true_m3": [b.true_m3 for b in every],
        "volume_m3": [b.excavation.removed_m3 for b in every],
        "sigma_m3": [b.excavation.sigma_m3 for b in every],
        "closed_m3": [b.excavation.closed_m3 for b in every],
        "watertight": all(watertight(b.excavation.between.triangles) for b in every),
        "bias_pct": float(error.mean()),
        "spread_pct": spread(error),
        "predicted_sigma_pct": float(np.sqrt((sigma**2).mean())),
        "coverage_95": float(np.mean(np.abs(normal) <= 1.96)),
        "pole_spread": max(b.excavation.between.pole_spread_m3 / b.true_m3 for b in every),
        "published_bias_pct": float(published.mean()),
        "published_spread_pct": spread(published),
        "density_bias_pct": float(rho.mean()),
        "density_spread_pct": spread(rho),
        "density_coverage_95": float(np.mean(inside)),
        "spheres_used": [len(u) for b in every for u in b.used],
        "size_shares": size_shares(study.bodies[0][1]),
        "resolution": {n: getattr(s, n).tolist() for n in ("cell_m", "volume_m3", "area_m2")}
        | {"dimension": s.dimension},
    }


def spread(values: F64) -> float:
    """Sample standard deviation; NaN for one value."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else float("nan")

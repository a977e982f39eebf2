"""Density from weighed mass and measured volume, and how large a body has to be (seed 003 sections
1 and 4).

``rho = m / V``. With relative sigmas u of the mass and v of the volume, both normal, ``var rho /
rho² = u² + v² + 3 u² v² + 8 v⁴`` to fourth order, and the mean of the quotient lies ``v²`` above
the quotient of the means. The interval is Fieller's, which is exact and not symmetric.

The accuracy of a volume goes with S / V, the surface per volume: 3 / r for a sphere, 6 / a for a
cube. How fast it falls with size depends on the kind of error, which is why one rule does not do
for all (:func:`relative_errors`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64


@dataclass(frozen=True)
class Mass:
    """mass_kg · sigma_kg"""

    mass_kg: float
    sigma_kg: float


@dataclass(frozen=True)
class Density:
    """density_kg_m3 · sigma_kg_m3 · interval_kg_m3 : Fieller's, for the coverage factor ·
    bias_kg_m3 : what the quotient is expected to be too large by · variance_shares : (mass, volume)
    of the first-order variance, together 1
    """

    density_kg_m3: float
    sigma_kg_m3: float
    interval_kg_m3: tuple[float, float]
    coverage_factor: float
    bias_kg_m3: float
    variance_shares: tuple[float, float]


def require_number(value: float, name: str, above: float | None = None) -> float:
    """A finite number, at least 0, or above ``above``. Raises :class:`VolumeError`
    (density_value).
    """
    v = float(value)
    if not np.isfinite(v) or v < 0.0 or (above is not None and v <= above):
        wanted = "0 or more" if above is None else f"above {above:g}"
        raise VolumeError(
            f"{name} is {value}; it must be {wanted}", reason="density_value", value=value
        )
    return v


def weighed_mass(loads_kg: F64, sigma_load_kg: float, sigma_calibration: float = 0.0) -> Mass:
    """Mass of loads (n,) kg weighed one by one (net, lorry by lorry): independent sigma of each,
    and a relative calibration error of the scales, which all share and which does not average out.
    """
    loads = np.asarray(loads_kg, dtype=np.float64)
    if loads.ndim != 1 or len(loads) == 0 or not np.isfinite(loads).all():
        raise VolumeError(
            "loads are a list of finite masses", reason="density_value", value=loads_kg
        )
    one, shared = (
        require_number(sigma_load_kg, "the sigma of a load"),
        require_number(sigma_calibration, "the calibration's sigma"),
    )
    total = float(loads.sum())
    return Mass(total, float(np.hypot(one * np.sqrt(len(loads)), shared * total)))


def density(
    mass_kg: float,
    sigma_mass_kg: float,
    volume_m3: float,
    sigma_volume_m3: float,
    coverage_factor: float = 1.96,
) -> Density:
    """Density of a body whose mass (kg) and volume (m³) have independent errors.

    Raises :class:`VolumeError`: density_value for a negative or non-finite number or no mass;
    density_undetermined where the volume is not above zero by the coverage factor, so that no
    interval is finite.
    """
    m = require_number(mass_kg, "the mass", 0.0)
    u = require_number(sigma_mass_kg, "the sigma of the mass")
    v, s = float(volume_m3), require_number(sigma_volume_m3, "the sigma of the volume")
    k = require_number(coverage_factor, "the coverage factor", 0.0)
    if not np.isfinite(v) or v <= k * s or v <= 0.0:
        raise VolumeError(
            f"a volume of {v:g} m³ with sigma {s:g} m³ is not above zero at {k:g} sigma: "
            "the density has no upper bound",
            reason="density_undetermined",
            value=v,
        )
    rho, um, uv = m / v, u / m, s / v
    a, c = 1.0 - (k * uv) ** 2, 1.0 - (k * um) ** 2
    root = float(np.sqrt(max(1.0 - a * c, 0.0)))
    variance = um**2 + uv**2 + 3.0 * um**2 * uv**2 + 8.0 * uv**4
    first = um**2 + uv**2
    shares = (um**2 / first, uv**2 / first) if first > 0.0 else (0.0, 0.0)
    return Density(
        rho,
        rho * float(np.sqrt(variance)),
        (rho * (1.0 - root) / a, rho * (1.0 + root) / a),
        k,
        rho * uv**2,
        shares,
    )


def relative_errors(
    area_m2: float,
    volume_m3: float,
    *,
    offset_m: float = 0.0,
    noise_m: float = 0.0,
    spacing_m: float = 0.0,
    correlated_m: float = 0.0,
    correlation_length_m: float = 0.0,
    scale: float = 0.0,
    height_m: float = 0.0,
    plan_area_m2: float = 0.0,
) -> dict[str, float]:
    """What each class of error is of the volume, as a share of it, for a body of surface S (m²) and
    volume V (m³).

    offset : the whole surface lies ``offset_m`` outward: ``S δ / V``, falls with V^(−1/3) · noise :
    independent ``noise_m`` of points at ``spacing_m``: ``σ d √S / V``, V^(−2/3) · correlated :
    ``correlated_m``, exponentially correlated over ``correlation_length_m`` L: ``σ S √(2π L² / S) /
    V`` as long as that is below an offset's share, V^(−2/3) · scale : ``3 scale``, whatever the
    size · height : one of two surfaces lies ``height_m`` too high over ``plan_area_m2``:
    registration of two epochs, V^(−1/3). Raises :class:`VolumeError`.
    """
    S, V = require_number(area_m2, "the surface", 0.0), require_number(volume_m3, "the volume", 0.0)
    L = require_number(correlation_length_m, "the correlation length")
    return {
        "offset": require_number(offset_m, "the offset") * S / V,
        "noise": require_number(noise_m, "the noise")
        * require_number(spacing_m, "the spacing")
        * float(np.sqrt(S))
        / V,
        "correlated": require_number(correlated_m, "the correlated error")
        * S
        / V
        * float(np.sqrt(min(1.0, 2.0 * np.pi * L**2 / S))),
        "scale": 3.0 * require_number(scale, "the scale error"),
        "height": require_number(height_m, "the height error")
        * require_number(plan_area_m2, "the plan area")
        / V,
    }


def cube_surface(volume_m3: float) -> float:
    """Surface of a cube, m²: ``6 V^(2/3)``."""
    return float(6.0 * require_number(volume_m3, "the volume", 0.0) ** (2.0 / 3.0))


def least_cube(offset_m: float, share: float) -> float:
    """Volume, m³, from which an offset of a cube's whole surface is at most this share of it: ``(6
    δ / share)³``.
    """
    return float(
        (
            6.0
            * require_number(offset_m, "the offset", 0.0)
            / require_number(share, "the share", 0.0)
        )
        ** 3
    )


def implied_offset(volume_m3: float, share: float) -> float:
    """Offset of a cube's whole surface, m, that is this share of its volume: ``share V^(1/3) /
    6``.
    """
    return float(
        require_number(share, "the share", 0.0)
        * require_number(volume_m3, "the volume", 0.0) ** (1.0 / 3.0)
        / 6.0
    )


def size_rule(
    offset_m: float = 0.01, share: float = 0.05, published_m3: float = 100.0
) -> list[str]:
    """Lines that print the rule with the published one beside it, each with its assumption."""
    least, implied = least_cube(offset_m, share), implied_offset(published_m3, share)
    at = relative_errors(cube_surface(published_m3), published_m3, offset_m=offset_m)["offset"]
    return [
        (
            f"cube, whole surface off by {100 * offset_m:g} cm: {100 * share:g} % at "
            f"{least:.2g} m³, {100 * at:.2g} % at {published_m3:g} m³"
        ),
        f"published: {100 * share:g} % needs more than {published_m3:g} m³; no derivation "
        "is given. It holds for a whole surface off by "
        f"{100 * implied:.2g} cm, {implied / offset_m:.2g} times the stated {100 * offset_m:g} cm",
    ]

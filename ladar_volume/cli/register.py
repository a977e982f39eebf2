"""``ladar_volume register``: the transform between two frames from the points measured on common
reference spheres.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ladar_volume.io.pointfiles.cloud_files import check_output, read_cloud, write_cloud
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64
from ladar_volume.registration.sphere_adjustment import Registration, register
from ladar_volume.registration.spheres import Sphere, fit_sphere
from ladar_volume.registration.stillness import Stillness, check_drift
from ladar_volume.version import version


def read_spheres(
    path: Path, noise: float | None, radius: float | None
) -> dict[int, tuple[Sphere, Stillness | None]]:
    """The spheres of one file by number, with the check of their rest where there are times."""
    cloud = read_cloud(path)
    if "sphere" not in cloud.columns:
        raise RegistrationError(
            f"{path}: no column 'sphere' that numbers the spheres", reason="registration_column"
        )
    number = np.asarray(cloud.columns["sphere"])
    out = {}
    for k in np.unique(number):
        rows = number == k
        try:
            sphere = fit_sphere(cloud.r[rows], noise, radius)
            still = (
                check_drift(cloud.r[rows], cloud.columns["t"][rows], sphere)
                if "t" in cloud.columns
                else None
            )
        except RegistrationError as error:
            raise RegistrationError(
                f"{path}, sphere {int(k)}: {error}", reason=error.reason, value=error.value
            ) from error
        out[int(k)] = sphere, still
    return out


def run(arguments: argparse.Namespace) -> int:
    """Fit, register, transform, print."""
    if (arguments.apply is None) != (arguments.output is None):
        raise RegistrationError("--apply and -o go together", reason="registration_options")
    if arguments.output is not None:
        check_output(arguments.output)
    a = read_spheres(arguments.a, arguments.noise_a, arguments.radius)
    b = read_spheres(arguments.b, arguments.noise_b, arguments.radius)
    names = sorted(a.keys() & b.keys())
    found = register(
        centres(a, names),
        centres(b, names),
        covariances(a, names),
        covariances(b, names),
        levelled=arguments.levelled,
        scale=None if arguments.free_scale else 1.0,
    )
    if arguments.apply is not None:
        cloud = read_cloud(arguments.apply)
        turned = {
            name: c @ found.transform.R.T if name == "normal" else c
            for name, c in cloud.columns.items()
        }
        write_cloud(arguments.output, found.transform.apply(cloud.r), turned)
    facts = facts_of(found, names, a, b)
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(Console(), facts)
    return 0


def centres(spheres: dict[int, tuple[Sphere, Stillness | None]], names: list[int]) -> F64:
    """Centres (n, 3) m, by number."""
    return np.array([spheres[k][0].centre for k in names]).reshape(-1, 3)


def covariances(spheres: dict[int, tuple[Sphere, Stillness | None]], names: list[int]) -> F64:
    """Covariances (n, 3, 3) m² of the centres, by number."""
    return np.array([spheres[k][0].C_centre for k in names]).reshape(-1, 3, 3)


def facts_of(
    found: Registration,
    names: list[int],
    a: dict[int, tuple[Sphere, Stillness | None]],
    b: dict[int, tuple[Sphere, Stillness | None]],
) -> dict[str, Any]:
    """The result as plain values: angles in rad, lengths in m."""
    T = found.transform
    spheres = [
        {
            "sphere": k,
            "used": bool(found.used[i]),
            "residual_m": found.residuals[i].tolist(),
            "p_value": float(found.p_value[i]),
            "radius_m": [a[k][0].radius, b[k][0].radius],
            "still": [None if s is None else s.still for s in (a[k][1], b[k][1])],
        }
        for i, k in enumerate(names)
    ]
    return {
        "matrix": T.matrix().tolist(),
        "scale": T.scale,
        "pivot_m": T.pivot.tolist(),
        "covariance": T.C.tolist(),
        "sigma_rotation_rad": np.sqrt(np.diag(T.C)[:3]).tolist(),
        "sigma_shift_m": np.sqrt(np.diag(T.C)[3:6]).tolist(),
        "sigma0": found.sigma0,
        "p_global": found.p_global,
        "redundancy": found.redundancy,
        "consistent": found.consistent,
        "spheres": spheres,
        "unmatched": sorted(a.keys() ^ b.keys()),
        "version": version(),
    }


def show(console: Console, facts: dict[str, Any]) -> None:
    """Print the facts as a short table."""
    table = Table(
        "sphere", "residual x, y, z (mm)", "p", "used", "stood still", box=None, pad_edge=False
    )
    words = {True: "yes", False: "[bold]no[/bold]", None: "-"}
    for s in facts["spheres"]:
        residual = " ".join(f"{1e3 * v:8.1f}" for v in s["residual_m"])
        table.add_row(
            str(s["sphere"]),
            residual,
            f"{s['p_value']:.3f}",
            words[s["used"]],
            " ".join(words[w] for w in s["still"]),
        )
    console.print(table)
    rotation, shift = (
        " ".join(f"{1e3 * v:.2f}" for v in facts[key])
        for key in ("sigma_rotation_rad", "sigma_shift_m")
    )
    console.print(
        f"sigma of the rotation {rotation} mrad, of the shift amid the spheres {shift} "
        f"mm, scale {facts['scale']:.6f}"
    )
    verdict = (
        "the spheres agree"
        if facts["consistent"]
        else "[bold]the spheres do not agree within their noise[/bold]"
    )
    console.print(f"{verdict} (redundancy {facts['redundancy']}, sigma0 {facts['sigma0']:.2f})")

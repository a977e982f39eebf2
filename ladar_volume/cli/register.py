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

from ladar_volume.cli.verdict_lines import add_verdict_rows, exit_code
from ladar_volume.io.pointfiles.cloud_files import check_output, read_cloud, write_cloud
from ladar_volume.io.results import json_text
from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64
from ladar_volume.registration.correspondence import Centres, Correspondence, correspond
from ladar_volume.registration.sphere_verdict import SphereMeasurement, sphere_verdict
from ladar_volume.registration.spheres import fit_sphere
from ladar_volume.registration.stillness import check_drift
from ladar_volume.version import version

#: A radius that differs from the given one by more than this share is refused.
WRONG_RADIUS = 0.1


def read_spheres(
    path: Path, noise: float | None, radius: float | None
) -> dict[int, SphereMeasurement]:
    """The spheres of one file by number, with the check of their rest where there are times."""
    cloud = read_cloud(path)
    if "sphere" not in cloud.columns:
        raise RegistrationError(
            f"{path}: no column 'sphere' that numbers the spheres", reason="registration_column"
        )
    number = np.asarray(cloud.columns["sphere"])
    whole = number.dtype.kind in "fiu" and number.ndim == 1
    if not (whole and (np.abs(number) < 2**53).all() and (number == np.floor(number)).all()):
        raise RegistrationError(
            f"{path}: the column 'sphere' holds what is no whole number",
            reason="registration_column",
        )
    out = {}
    for k in np.unique(number):
        rows = number == k
        t = cloud.columns["t"][rows] if "t" in cloud.columns else None
        try:
            out[int(k)] = measure_sphere(cloud.r[rows], t, noise, radius)
        except RegistrationError as error:
            raise RegistrationError(
                f"{path}, sphere {int(k)}: {error}", reason=error.reason, value=error.value
            ) from error
    return out


def measure_sphere(
    points: F64, t_s: F64 | None, noise: float | None, radius: float | None
) -> SphereMeasurement:
    """One sphere from its points (n, 3); where a radius is given, also without it.

    Raises :class:`RegistrationError` as ``fit_sphere`` and ``check_drift`` do, and sphere_radius
    where the points clearly have another radius.
    """
    try:
        free = None if radius is None else fit_sphere(points, noise)
    except RegistrationError:  # the points do not bear a free radius
        free = None
    if free is not None and radius is not None and radius > 0.0:
        off = abs(free.radius - radius)
        if off > max(WRONG_RADIUS * radius, 5.0 * float(np.sqrt(free.C[3, 3]))):
            raise RegistrationError(
                f"its points have a radius of {free.radius:.4g}, not {radius:.4g}: give the "
                "right --radius, or check the units of the file",
                reason="sphere_radius",
                value=free.radius,
            )
    sphere = fit_sphere(points, noise, radius)
    return SphereMeasurement(
        sphere, free, None if t_s is None else check_drift(points, t_s, sphere)
    )


def run(arguments: argparse.Namespace) -> int:
    """Fit, register, transform, print."""
    if (arguments.apply is None) != (arguments.output is None):
        raise RegistrationError("--apply and -o go together", reason="registration_options")
    if arguments.output is not None:
        check_output(arguments.output)
    a = read_spheres(arguments.a, arguments.noise_a, arguments.radius)
    b = read_spheres(arguments.b, arguments.noise_b, arguments.radius)
    one, two = centres(a), centres(b)
    found = correspond(
        one,
        two,
        levelled=arguments.levelled,
        scale=None if arguments.free_scale else 1.0,
    )
    parts = [
        (a[int(i)], b[int(j)])
        for i, j in zip(one.number[found.rows_a], two.number[found.rows_b], strict=True)
    ]
    verdict = sphere_verdict(found, one, two, parts)
    if arguments.apply is not None:
        cloud, T = read_cloud(arguments.apply), found.registration.transform
        turned = {name: c @ T.R.T if name == "normal" else c for name, c in cloud.columns.items()}
        write_cloud(arguments.output, T.apply(cloud.r), turned)
    facts = facts_of(found, one, two, parts) | {"verdict": verdict.as_dict()}
    if arguments.json:
        print(json_text(facts), end="")
    else:
        show(Console(), facts)
    return exit_code(arguments, facts["verdict"])


def centres(spheres: dict[int, SphereMeasurement]) -> Centres:
    """The centres by number."""
    number = sorted(spheres)
    r = np.array([spheres[k].sphere.centre for k in number]).reshape(-1, 3)
    C = np.array([spheres[k].sphere.C_centre for k in number]).reshape(-1, 3, 3)
    return Centres(np.array(number, np.int64), r, C)


def facts_of(
    c: Correspondence,
    one: Centres,
    two: Centres,
    parts: list[tuple[SphereMeasurement, SphereMeasurement]],
) -> dict[str, Any]:
    """The result as plain values: angles in rad, lengths in m."""
    found = c.registration
    T, number, number_b = found.transform, one.number[c.rows_a], two.number[c.rows_b]
    spheres = [
        {
            "sphere": int(number[i]),
            "sphere_b": int(number_b[i]),
            "used": bool(found.used[i]),
            "residual_m": found.residuals[i].tolist(),
            "p_value": float(found.p_value[i]),
            "radius_m": [m.sphere.radius for m in pair],
            "still": [None if m.still is None else m.still.still for m in pair],
        }
        for i, pair in enumerate(parts)
    ]
    alone = (set(one.number) - set(number)) | (set(two.number) - set(number_b))
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
        "renumbered": c.renumbered,
        "spheres": spheres,
        "unmatched": sorted(int(k) for k in alone),
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
        own, other = s["sphere"], s["sphere_b"]
        table.add_row(
            str(own) if own == other else f"{own} = {other}",
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
    console.print(f"redundancy {facts['redundancy']}, sigma0 {facts['sigma0']:.2f}")
    table = Table(show_header=False, box=None, pad_edge=False)
    add_verdict_rows(table, facts["verdict"])
    console.print(table)

"""Self-calibration of simulated flights over a stockpile: is the boresight found, and does its
covariance tell the truth?

Every seed is a new flight in lanes with newly drawn errors: boresight as in seed 004's archive
(0.16, 0.08, 0.27 degrees), a clock offset of 20 ms sigma, the attitude of its instrument, position
by RTK. The truth is read here and nowhere in the pipeline.
"""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from pathlib import Path

import numpy as np

from ladar_volume.cli.main import main

SEEDS = range(2000, 2008)
CONFIG = """/**:
  ros__parameters:
    budget:
      boresight_sigma_deg: [0.1563055, 0.08494642, 0.26614251]
      clock_sigma_s: 0.02
      attitude_sigma_deg: [0.004, 0.004, 0.01]
"""
NAMES = ("boresight_x", "boresight_y", "boresight_z", "clock")


def calibrated(
    seed: int, folder: Path, extra: tuple[str, ...] = ("--thin", "20", "--mixed", "0")
) -> tuple[np.ndarray, np.ndarray, float]:
    """Errors (10,) of the constants of one flight, their covariance (10, 10), and chi-square per
    degree of freedom.
    """
    bag, config = folder / f"lanes_{seed}", folder / "config.yaml"
    config.write_text(CONFIG)
    words = [
        "simulate",
        "stockpile",
        "--platform",
        "lanes",
        "--duration",
        "72",
        "--seed",
        str(seed),
        "--config",
        str(config),
    ]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if main([*words, *extra, "-o", str(bag)]) or main(
            ["calibrate", "strips", str(bag), "--json"]
        ):
            raise RuntimeError(f"seed {seed} failed")
    facts, truth = json.loads(printed.getvalue()), json.loads((bag / "truth.json").read_text())
    nominal_laser, nominal_antenna = (0.12, 0.0, -0.15), (-0.10, 0.05, 0.25)
    true = np.concatenate(
        [
            truth["boresight_error_rad"],
            np.subtract(truth["lever_laser_m"], nominal_laser),
            np.subtract(truth["lever_antenna_m"], nominal_antenna),
            [truth["clock_error_s"]],
        ]
    )
    found = np.array([facts["constants"][name]["correction"] for name in facts["columns"]])
    return found - true, np.array(facts["covariance"]), facts["chi2"] / facts["freedom"]


def run() -> dict[str, float | int | str]:
    """Errors, their size against the printed sigma, and chi-square over the seeds."""
    errors, scores, nees, chi2 = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for seed in SEEDS:
            error, C, ratio = calibrated(seed, Path(folder))
            errors.append(error[[0, 1, 2, 9]])
            scores.append(errors[-1] / np.sqrt(np.diag(C))[[0, 1, 2, 9]])
            nees.append(float(error @ np.linalg.solve(C, error)))
            chi2.append(ratio)
            print(
                (
                    f"seed {seed}: z {np.round(scores[-1], 2)}, error² over covariance "
                    f"{nees[-1]:.1f}, chi2 {ratio:.2f}"
                ),
                flush=True,
            )
    rms, normal = (np.sqrt(np.mean(np.square(v), axis=0)) for v in (errors, scores))
    units = (180 / np.pi, 180 / np.pi, 180 / np.pi, 1e3)
    return {
        "flights": len(nees),
        **{
            f"rms error of {n} / {'ms' if n == 'clock' else 'deg'}": float(r * u)
            for n, r, u in zip(NAMES, rms, units, strict=True)
        },
        **{f"error over sigma of {n}, rms": float(v) for n, v in zip(NAMES, normal, strict=True)},
        "error² over covariance, ten constants (10 is true)": float(np.mean(nees)),
        "chi-square of the strips per degree of freedom": float(np.mean(chi2)),
    }


if __name__ == "__main__":
    print(run())

"""Twenty new surveys of the stockpile through the whole engine: does the printed sigma tell the
truth?

Every seed is a new flight with newly drawn errors, simulated to a bag and replayed by the command
line's own replay; the true volume is read here and nowhere in the pipeline.
"""

from __future__ import annotations

import contextlib
import io
import json
import statistics
import tempfile
from pathlib import Path

from ladar_volume.cli.main import main

SEEDS = range(1000, 1020)
THIN = 15


def survey(
    seed: int, folder: Path, scene: str = "stockpile", platform: str = "uav"
) -> tuple[float, float, float]:
    """True volume, measured volume and sigma (m³) of one simulated survey."""
    bag = folder / f"{scene}_{seed}"
    with contextlib.redirect_stdout(io.StringIO()):
        if main(
            [
                "simulate",
                scene,
                "--platform",
                platform,
                "--seed",
                str(seed),
                "--thin",
                str(THIN),
                "-o",
                str(bag),
            ]
        ):
            raise RuntimeError(f"simulation of seed {seed} failed")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        if main(["replay", str(bag), "--json", "--no-figure", "-o", str(folder / f"out_{seed}")]):
            raise RuntimeError(f"replay of seed {seed} failed")
    result = json.loads(printed.getvalue())
    truth = json.loads((bag / "truth.json").read_text())
    return truth["volume_m3"], result["volume_m3"], result["sigma_m3"]


def run() -> dict[str, float | int | str]:
    """Bias, spread, mean sigma and coverage over the seeds."""
    errors, sigmas, volume, inside = [], [], 0.0, 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in SEEDS:
            volume, measured, sigma = survey(seed, Path(folder))
            errors.append(measured - volume)
            sigmas.append(sigma)
            inside += abs(measured - volume) <= 1.96 * sigma
            print(
                (
                    f"seed {seed}: V = {measured:.3f} ± {sigma:.3f} m³, true {volume:.3f} m³, "
                    f"error {errors[-1]:+.3f} m³"
                ),
                flush=True,
            )
    spread, mean_sigma = statistics.stdev(errors), statistics.fmean(sigmas)
    return {
        "surveys": len(errors),
        "true volume / m³": volume,
        "bias / %": 100 * statistics.fmean(errors) / volume,
        "spread / %": 100 * spread / volume,
        "mean sigma / %": 100 * mean_sigma / volume,
        "spread / mean sigma": spread / mean_sigma,
        "95 % intervals that hold the truth": inside,
    }


if __name__ == "__main__":
    print(run())

"""How ``replay --dask`` grows past one machine: its task graph, simulated with measured costs.

    python benchmarks/task_graph.py

Pieces of time go to the first free worker; when all are done, tiles do, the largest first; then one
process reads the patches and estimates. A task computes and moves its bytes to or from storage that
all share. Costs are those of ``bags/stockpile`` on one thread (docs/scale.md).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

#: CPU seconds: of the poses by second of recording, of a return, of a row at rest, of a patch in
#: the last step; bytes of a row and of a patch at rest, of a return in the recording, and of a
#: patch in the memory of the last step.
POSES_S, RETURN_S, ROW_S, PATCH_S = 0.015, 2.7e-6, 16.5e-6, 39e-6
ROW_B, PATCH_B, RETURN_B, HELD_B = 113.0, 7700.0, 13.0, 215.0
#: Rows and patches of a square metre, returns a second, seconds of a piece, m of a tile.
ROWS_M2, PATCHES_M2, RATE, PIECE_S, TILE_M = 67.0, 3.5, 300e3, 60.0, 50.0
#: What the scheduler takes for a task, s.
SCHEDULER_S = 1e-3


@dataclass(frozen=True)
class Plan:
    """returns : of the survey · density : a square metre · workers · link, storage : bytes a second
    of a worker, and of what all read from and write to
    """

    returns: float
    density: float
    workers: int
    link: float = 250e6
    storage: float = 10e9


def stage(cpu_s: np.ndarray, moved: np.ndarray, plan: Plan) -> float:
    """Seconds until tasks, in this order, are done by the first free workers."""
    rate = min(plan.link, plan.storage / plan.workers)
    free = [0.0] * plan.workers
    ends = 0.0
    for k, (cpu, size) in enumerate(zip(cpu_s.tolist(), moved.tolist(), strict=True)):
        begin = max(heapq.heappop(free), (k + 1) * SCHEDULER_S)
        end = begin + cpu + size / rate
        heapq.heappush(free, end)
        ends = max(ends, end)
    return ends


def simulated(plan: Plan, seed: int = 0) -> dict[str, float]:
    """Seconds of each stage, and bytes."""
    rng = np.random.default_rng(seed)
    area, seconds = plan.returns / plan.density, plan.returns / RATE
    pieces, tiles = max(1, round(seconds / PIECE_S)), max(1, round(area / TILE_M**2))
    uneven = rng.lognormal(-0.02, 0.2, pieces)  # machines and pieces are not alike
    returns, halo = plan.returns / pieces * uneven, (1.0 + 12 * 0.6 / TILE_M) ** 2
    rows = area * ROWS_M2 * halo
    one = stage(returns * RETURN_S, returns * RETURN_B + rows / pieces * ROW_B * uneven, plan)
    of = np.sort(rng.lognormal(-0.08, 0.4, tiles))[::-1] * rows / tiles
    patches = area * PATCHES_M2
    two = stage(of * ROW_S, of * ROW_B + patches / tiles * PATCH_B, plan)
    last = patches * (PATCH_S + PATCH_B / plan.link)
    poses = seconds * POSES_S
    work = plan.returns * RETURN_S + rows * ROW_S
    return {
        "poses": poses,
        "pieces": one,
        "tiles": two,
        "last": last,
        "share": work / plan.workers / (poses + one + two + last),
        "rest_tb": (rows * ROW_B + patches * PATCH_B) / 1e12,
        "last_gb": patches * HELD_B / 1e9,
    }


def main() -> None:
    print("| returns | a m² | workers | poses h | pieces h | tiles h | last step h | busy ", end="")
    print("| TB at rest | GB in the last step |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for returns, workers in ((1e8, 2), (1e9, 10), (1e10, 100), (1e12, 1000)):
        s = simulated(Plan(returns, 400.0, workers))
        hours = " | ".join(f"{s[name] / 3600:.2f}" for name in ("poses", "pieces", "tiles", "last"))
        print(
            f"| {returns:.0e} | 400 | {workers} | {hours} | {100 * s['share']:.0f} % "
            f"| {s['rest_tb']:.3g} | {s['last_gb']:.3g} |"
        )


if __name__ == "__main__":
    main()

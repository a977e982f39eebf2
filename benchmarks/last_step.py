"""What the last step of ``ladar_volume replay --tile`` costs, by the number of patches.

    python benchmarks/last_step.py BAG FOLDER K [APART [PARAMETER=VALUE …]]

puts K by K copies of the patches of a recording side by side, APART m from one another (75), as
many tiles have them, and prints how many there are, the seconds and the memory until they are one
surface, and those of the estimate. The outline holds one copy; the other ones are ground, and
bodies of their own with volume.bodies=0.
"""

from __future__ import annotations

import dataclasses
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np

from ladar_volume.io.bags import BagReader
from ladar_volume.io.config import read_config
from ladar_volume.replay import Replay
from ladar_volume.rmls.tile_filter import TilePatches
from ladar_volume.rmls.voxel_store import pack_key, unpack_key
from ladar_volume.tiled_replay import tiled_survey
from ladar_volume.tiled_replay.tiled_survey import TiledReplay, Work
from ladar_volume.tiled_replay.whole_surface import Reader, WholeSurface
from ladar_volume.tiles.tile_work import OwnProcess


class Peak:
    """Largest memory of this process without pages of files, MB, and seconds, since asked last."""

    def __init__(self) -> None:
        self.most, self.since = 0.0, time.perf_counter()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while True:
            words = Path("/proc/self/status").read_text().split("RssAnon:")[1].split()
            self.most = max(self.most, int(words[0]) / 1024)
            time.sleep(0.05)

    def told(self) -> str:
        """Both in words."""
        now = time.perf_counter()
        words = f"{now - self.since:.1f} s, {self.most:.0f} MB"
        self.most, self.since = 0.0, now
        return words


def moved(reader: Reader, by: tuple[int, int], radius_m: float) -> TilePatches | None:
    """What a tile gives, so many voxels away."""
    found = reader()
    if found is None:
        return None
    voxels = np.array([*by, 0])

    def there(keys: np.ndarray) -> np.ndarray:
        return pack_key(unpack_key(keys) + voxels)

    points, patches = found.points, found.patches
    return dataclasses.replace(
        found,
        points=dataclasses.replace(
            points, patch=there(points.patch), r_map=points.r_map + voxels * radius_m
        ),
        patches=dataclasses.replace(
            patches,
            key=there(patches.key),
            cross_key=there(patches.cross_key),
            centre=patches.centre + voxels * radius_m,
        ),
    )


def main() -> None:
    bag_path, folder, copies = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    apart_m = float(sys.argv[4]) if len(sys.argv) > 4 else 75.0
    folder.mkdir(parents=True, exist_ok=True)
    parameters = read_config(bag_path / "config.yaml", sys.argv[5:])
    radius_m = parameters.filter.radius_m
    step, peak = round(apart_m / radius_m), Peak()

    def copied(readers: list[Reader], store: Path) -> WholeSurface:
        peak.told()
        every = [(i * step, j * step) for i in range(copies) for j in range(copies)]
        many = [partial(moved, reader, by, radius_m) for by in every for reader in readers]
        whole = WholeSurface(many, store)
        print(f"{whole.counts['patches']} patches are one surface: {peak.told()}", flush=True)
        return whole

    tiled_survey.WholeSurface = copied  # type: ignore[assignment, misc]
    with BagReader(bag_path) as bag:
        replay = Replay(bag, parameters, bag.roles({}))
        estimate = TiledReplay(replay, Work(50.0, folder, OwnProcess())).run()
    volume = estimate.volume
    words = f"{len(estimate.bodies)} bodies: {peak.told()}"
    print(f"{words}; {volume.volume_m3:.3f} ± {volume.sigma_m3:.3f} m³")


if __name__ == "__main__":
    main()

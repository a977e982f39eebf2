"""Whole sites as a surveyor gets them: LAZ with its CRS, one to three piles on sloping ground, and
trees, an excavator, strays, feet, degrees or few points; through the command line above the ground.

``volume --base ground`` measures the largest body and names the others. An answer is *silent* where
it is more than two sigma off every pile of the site with a sound verdict: there must be none beyond
one sound answer of twenty.

    python -m benchmarks.fresh_sites --first 9100 --seeds 3
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import tempfile
from pathlib import Path

import laspy
import numpy as np
import pyproj

from ladar_volume.cli.main import main as ladar_volume

KINDS = ("clean", "sparse", "trees", "machine", "strays", "full", "feet", "feet full", "degrees")
FOOT_M = 1200.0 / 3937.0


class Pile:
    """An elliptic cone or frustum: middle, half axes, turn, share of the flat top, height, m."""

    def __init__(self, rng: np.random.Generator, half: float) -> None:
        self.a = rng.uniform(4.0, 11.0)
        self.b = self.a * rng.uniform(0.6, 1.0)
        self.at = rng.uniform(self.a + 4.0 - half, half - self.a - 4.0, 2)
        self.turn = rng.uniform(0.0, math.pi)
        self.top = float(rng.choice([0.0, rng.uniform(0.1, 0.5)]))
        self.high = self.b * math.tan(math.radians(rng.uniform(25.0, 37.0))) * (1.0 - self.top)
        share = (1.0 + self.top + self.top**2) / 3.0
        self.volume_m3 = math.pi * self.a * self.b * self.high * share

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Above the ground."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        u, v = ((xy - self.at) @ np.array([[c, -s], [s, c]])).T
        reach = np.hypot(u / self.a, v / self.b)
        return self.high * np.clip((1.0 - reach) / (1.0 - self.top), 0.0, 1.0)


class Site:
    """Points (n, 3), m, and the piles that are in them."""

    def __init__(self, seed: int, kind: str) -> None:
        self.rng = rng = np.random.default_rng([seed, *map(ord, kind)])
        self.half = rng.uniform(28.0, 45.0)
        density = 8.0 if kind == "sparse" else rng.uniform(15.0, 40.0)
        xy = rng.uniform(-self.half, self.half, (rng.poisson(density * (2 * self.half) ** 2), 2))
        self.slope, self.waves = rng.normal(0.0, 0.02, 2), rng.normal(0.0, 0.3, (100, 2))
        self.phase = rng.uniform(0.0, 2.0 * math.pi, 100)
        self.piles: list[Pile] = []
        for _ in range(400):
            new = Pile(rng, self.half)
            if all(np.hypot(*(new.at - p.at)) > new.a + p.a + 3.0 for p in self.piles):
                self.piles.append(new)
            if len(self.piles) == 1 + seed % 3:
                break
        self.p = np.c_[xy, self.surface(xy) + rng.normal(0.0, rng.uniform(0.008, 0.025), len(xy))]
        for word, spoil in (("trees", self.trees), ("machine", self.machine), ("strays", self.off)):
            if kind == word or kind.endswith("full"):
                spoil()

    def ground(self, xy: np.ndarray) -> np.ndarray:
        """A slope with waves of some 1.5 cm."""
        swell = np.sin(xy @ self.waves.T + self.phase).sum(axis=1)
        return xy @ self.slope + 0.015 * math.sqrt(0.02) * swell

    def surface(self, xy: np.ndarray) -> np.ndarray:
        """Ground and piles."""
        return self.ground(xy) + np.max([p.height(xy) for p in self.piles], axis=0)

    def trees(self) -> None:
        """Crowns that half to most of the returns stay in."""
        for _ in range(self.rng.integers(3, 9)):
            at = self.rng.uniform(-self.half, self.half, 2)
            own = np.hypot(*(self.p[:, :2] - at).T) < self.rng.uniform(1.2, 2.8)
            own &= self.rng.random(len(self.p)) < self.rng.uniform(0.5, 0.85)
            crown = self.rng.uniform(4.0, 11.0) * self.rng.uniform(0.35, 1.0, int(own.sum()))
            self.p[own, 2] = self.surface(self.p[own, :2]) + crown

    def machine(self) -> None:
        """An excavator with its boom beside a pile."""
        pile, a = self.piles[0], self.rng.uniform(0.0, 2.0 * math.pi)
        at = pile.at + (pile.a + self.rng.uniform(0.5, 4.0)) * np.array([math.cos(a), math.sin(a)])
        q, floor = self.p[:, :2] - at, float(self.ground(at[None])[0])
        body = (np.abs(q) < (1.6, 2.4)).all(axis=1)
        self.p[body, 2] = floor + self.rng.uniform(2.6, 2.9) + self.noise(body)
        boom = (np.abs(q[:, 1]) < 0.35) & (q[:, 0] > 1.6) & (q[:, 0] < 7.0)
        bow = np.sin((q[boom, 0] - 1.6) / 5.4 * math.pi)
        self.p[boom, 2] = floor + 2.8 + 1.8 * bow + self.noise(boom)

    def noise(self, own: np.ndarray) -> np.ndarray:
        """2 cm for the points that are marked."""
        return self.rng.normal(0.0, 0.02, int(own.sum()))

    def off(self) -> None:
        """Some points per thousand are metres off."""
        own = self.rng.random(len(self.p)) < self.rng.uniform(0.001, 0.006)
        count = int(own.sum())
        self.p[own, 2] += self.rng.choice([-1, 1], count) * self.rng.exponential(3.0, count) + 0.3

    def write(self, path: Path, kind: str) -> None:
        """LAZ in the system of the kind."""
        crs, step = pyproj.CRS("EPSG:25832"), 1e-3
        r = self.p + np.array([512_000.0, 5_310_000.0, 80.0])
        if kind.startswith("feet"):
            crs = pyproj.CRS("EPSG:2229+6360")
            r = (self.p + np.array([1_950_000.0, 560_000.0, 80.0])) / FOOT_M
        if kind == "degrees":
            back = pyproj.Transformer.from_crs(crs, "EPSG:4258", always_xy=True)
            r[:, :2] = np.column_stack(back.transform(*r[:, :2].T))
            crs, step = pyproj.CRS("EPSG:4258"), 1e-9
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.add_crs(crs)
        header.scales, header.offsets = [step, step, 1e-3], np.floor(r.min(axis=0))
        las = laspy.LasData(header)
        las.x, las.y, las.z = r.T
        las.write(str(path))


def line(kind: str, seed: int) -> str:
    """What came of one site."""
    site, out, said = Site(seed, kind), io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "SITE.laz"
        site.write(path, kind)
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
            code = ladar_volume(["volume", str(path), "--base", "ground", "--json"])
    if code:
        return f"{kind:10s} {seed} refused: {said.getvalue().strip()[:120]}"
    facts = json.loads(out.getvalue())
    found, sigma, verdict = facts["net_m3"], facts["sigma_m3"], facts["verdict"]
    true = min((p.volume_m3 for p in site.piles), key=lambda v: abs(v - found))
    z = (found - true) / sigma
    silent = "SILENT" if abs(z) > 2.0 and verdict["status"] == "sound" else ""
    names = ", ".join(str(reason.get("name", "")) for reason in verdict["reasons"])
    words = f"{true:8.2f} m³, {found:8.2f} ± {sigma:5.2f}, z {z:7.2f}"
    return f"{kind:10s} {seed} {words} {verdict['status']} {names} {silent}"


def main() -> None:
    """Print a line for each site."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=9100)
    parser.add_argument("--seeds", type=int, default=3)
    a = parser.parse_args()
    for seed in range(a.first, a.first + a.seeds):
        for kind in KINDS:
            print(line(kind, seed), flush=True)


if __name__ == "__main__":
    main()

"""Random clouds of many kinds, and the results of ``volume`` for them at once and by tiles."""

import json

import laspy
import numpy as np

from ladar_volume.cli.main import main

#: Which part of a site 70 m by 45 m was surveyed.
SHAPES = {
    "box": lambda x, y: np.ones(len(x), bool),
    "L": lambda x, y: ~((x > 35) & (y > 25)),
    "notch": lambda x, y: ~((np.abs(x - 45) < 3) & (y > 12)),
    "hole": lambda x, y: np.hypot(x - 30, y - 20) >= 5,
    "ellipse": lambda x, y: np.hypot((x - 35) / 35, (y - 22) / 22) < 1,
    "two": lambda x, y: ~((np.abs(x - 50) < 4) & (np.abs(y - 20) < 30)),
}


def scattered(n, rng):
    return rng.random((n, 2)) * [70, 45]


def gridded(n, rng):
    side = np.sqrt(70 * 45 / n)
    x, y = np.meshgrid(np.arange(0, 70, side), np.arange(0, 45, side))
    return np.column_stack([x.ravel(), y.ravel()])


def on_lines(n, rng):
    return np.column_stack([rng.random(n) * 70, 1.1 * rng.integers(0, 41, n)])


def thinning_out(n, rng):
    xy = rng.random((n, 2)) * [70, 45]
    return xy[rng.random(n) < 1 / (1 + np.hypot(*(xy - [20, 20]).T) / 20)]


def site(kind, shape, n, rng, strays=0, alone=False):
    """A heap on a slope (k, 3), with strays and points alone beyond where these are asked for."""
    xy = kind(n, rng)
    xy = xy[SHAPES[shape](*xy.T)]
    heap = np.maximum(0.0, 4.0 - 0.5 * np.hypot(*(xy - [28, 22]).T))
    z = 100.0 + heap + 0.02 * xy[:, 0] + rng.normal(0, 0.02, len(xy))
    some = rng.choice(len(xy), strays, replace=False)
    z[some] += rng.choice([-1, 1], strays) * rng.uniform(0.3, 6.0, strays)
    p = np.column_stack([xy, z])
    if alone:
        p = np.vstack([p, [[95.0, 30, 100.5], [-8, 20, 100], [-8.5, 21, 100.2]]])
    return p + np.array([1000.0, -500.0, 0.0])


def write(path, p, rng):
    """Points in any order, to the millimetre."""
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [1e-3] * 3, [0.0] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = p[rng.permutation(len(p))].T
    las.write(path)
    return path


def volume(capsys, path, *words):
    """What ``volume --json`` says."""
    assert main(["volume", str(path), *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def differences(whole, tiled):
    """What differs, in words: values by 1e-9 of the volume, budget lines by 1e-7 of themselves, the
    words of doubts at all.
    """
    out = []
    size = abs(whole["cut_m3"]) + abs(whole["fill_m3"])
    for name in ("net_m3", "cut_m3", "fill_m3", "sigma_m3", "area_m2"):
        scale = whole[name] if name == "area_m2" else max(size, whole["sigma_m3"])
        if not abs(whole[name] - tiled[name]) <= 1e-9 * scale:
            out.append(f"{name} {whole[name]} {tiled[name]}")
    one, two = whole["budget_m6"], tiled["budget_m6"]
    for name in sorted({*one, *two}):
        a, b = one.get(name, 0.0), two.get(name, 0.0)
        if not abs(a - b) <= 1e-7 * max(a, b) + 1e-12 * whole["sigma_m3"] ** 2:
            out.append(f"{name} {a} {b}")
    said = [sorted(r["text"] for r in found["verdict"]["reasons"]) for found in (whole, tiled)]
    if said[0] != said[1]:
        out.append(f"{said[0]} {said[1]}")
    if whole["clean"]["strays"] != tiled["clean"]["strays"]:
        out.append(f"{whole['clean']} {tiled['clean']}")
    return out

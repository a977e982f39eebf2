"""Small yards as LAZ files: a pile on ground with one trouble each."""

import laspy
import numpy as np

SIGMA = 0.015
WIDE = np.array([60.0, 50.0])


def cone(x, y, at, high, slope=0.6):
    return np.maximum(0.0, high - np.hypot(x - at[0], y - at[1]) * slope)


def ground(x, y, waves=0.05, bend=0.0):
    uneven = waves * np.sin(x / 9) * np.cos(y / 7) + bend * (x - 30) ** 2
    return 100.0 + 0.02 * x - 0.01 * y + uneven


def yard(kind, seed, n=9000):
    """Points (k, 3) m."""
    rng = np.random.default_rng([seed, *kind.encode()])
    xy = rng.random((n, 2)) * WIDE
    if kind == "hole":
        xy = xy[(np.abs(xy[:, 0] - 30.0) > 4.0) | (np.abs(xy[:, 1] - 22.0) > 3.0)]
    x, y = xy.T
    g = ground(x, y, 0.05 * (kind != "flat"), 0.0015 * (kind == "bent"))
    pile = cone(x, y, (28.0, 24.0), 4.0)
    on_pad = 0.25 * ((np.abs(x - 28.0) < 11.0) & (np.abs(y - 24.0) < 11.0))
    h = {
        "pad": np.maximum(pile, on_pad),
        "two": pile + cone(x, y, (50.0, 40.0), 2.5),
        "edge": pile + cone(x, y, (5.0, 24.0), 5.0, 0.5),
        "wall": np.where((np.abs(x - 40.0) < 1.0) & (np.abs(y - 24.0) < 10.0), 3.0, pile),
        "grass": pile + (pile <= 0.0) * rng.gamma(2.0, 0.05, len(x)),
        "dune": 4.0 * np.exp(-np.hypot(x - 28.0, y - 24.0) / 5.0),
    }.get(kind, pile)
    return np.column_stack([xy, g + h + rng.normal(0.0, SIGMA, len(x))])


def write_yard(path, kind, seed=1):
    """Write it; returns the path."""
    las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
    las.header.scales = [1e-3] * 3
    las.x, las.y, las.z = yard(kind, seed).T
    las.write(path)
    return path

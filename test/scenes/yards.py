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
    return write_points(path, yard(kind, seed))


def write_points(path, r):
    """Write points (k, 3) m; returns the path."""
    las = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
    las.header.scales = [1e-3] * 3
    las.x, las.y, las.z = r.T
    las.write(path)
    return path


def bent_site(seed, bend=1.0):
    """Points (k, 3) m of a mound on ground that bends and undulates, or is flat."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 80.0, (6000, 2))
    along = xy[:, 0] - 40.0
    z = 0.004 * along**2 * np.sign(along) + 0.3 * np.sin(xy[:, 0] / 6) * np.cos(xy[:, 1] / 7)
    mound = 2.0 * np.exp(-((xy - 40.0) ** 2).sum(axis=1) / 30.0)
    return np.c_[xy, bend * z + mound + rng.normal(0.0, 0.02, len(xy))]

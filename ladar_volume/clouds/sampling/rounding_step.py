"""The step to which coordinates were rounded: digits of a text file, the scale of a LAS file, or
what 32 bits hold of map coordinates.

Rounding to a step q adds the variance q² / 12 to each coordinate (Sheppard). Residuals of rounded
points are often exactly zero, and robust estimates then say that there is no noise: the noise is
told from points spread evenly over their steps, which adds the same variance once more.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from ladar_volume.clouds.filter.noise_estimate import hashes
from ladar_volume.clouds.filter.point_reduction import rounding_variance
from ladar_volume.model.records import F64

#: Coordinates that tell the step; the share of them that must be its multiples, and how closely.
LOOKED_AT, SHARE, NEAR = 4000, 0.995, 0.05
#: Fewest different values that tell a step.
DIFFERENT = 8
#: Significant digits of steps in metres, international and US survey feet.
DIGITS = (1.0, 2.0, 2.5, 5.0)
UNITS = (1.0, 0.3048, 1200.0 / 3937.0)
#: Noise over the step from which on rounding shifts nothing.
LOUD = 1.5
#: Steps are sought within these shares of a cloud's width.
FINEST, COARSEST = 1e-9, 0.1
#: What one axis alone has, so many times coarser than another axis and so many times wider than the
#: distance to the nearest point, is the distance of scan lines and no rounding: points rounded in
#: all axes are never nearer to each other than the step.
ALONE, WIDER = 10.0, 4.0


def rounding_steps(r: F64) -> F64:
    """Step (3,) m of each coordinate of points (n, 3); 0 where there is none that matters."""
    some = lowest_hashes(r)
    steps = [_step(some[:, axis]) for axis in range(3)]
    coarsest = max((step for step in steps if step is not None), default=0.0)
    # what says nothing, such as one height for all, was rounded as the others
    found = np.array([coarsest if step is None else step for step in steps])
    alone = found > ALONE * found.min()
    if alone.any():
        found[alone & (found > WIDER * _nearest(r, some))] = 0.0
    return found


def lowest_hashes(r: F64) -> F64:
    """As many of the points (n, 3) as tell the step: by their hashes, the same in any order."""
    if len(r) <= LOOKED_AT:
        return r
    return r[np.argpartition(_point_hashes(r, 0), LOOKED_AT)[:LOOKED_AT]]


def _nearest(r: F64, some: F64) -> float:
    """Median distance, m, of some of the points (n, 3) to the nearest other point."""
    low = r.min(axis=0)
    distance = cKDTree(r - low, balanced_tree=False).query(some - low, k=2)[0]
    return float(np.median(np.reshape(distance, (-1, 2))[:, 1]))


def _step(x: F64) -> float | None:
    """The largest step that divides the differences of x (n,); None for too few values."""
    some = np.unique(x)
    width = float(some[-1] - some[0])
    if len(some) < DIFFERENT:
        return None
    resolution = 2.0 ** np.floor(np.log2(np.abs(some).max()))  # of the leading digit
    single = bool((some == some.astype(np.float32)).all())
    precision = float(resolution * (2.0**-23 if single else 2.0**-52))
    low, high = max(FINEST * width, 4.0 * precision), COARSEST * width
    if low < np.finfo(np.float64).tiny:
        return 0.0  # steps below what doubles resolve
    if high > low:
        decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
        candidates = np.outer(np.outer(DIGITS, UNITS).ravel(), decades).ravel()
        powers = 2.0 ** np.arange(np.floor(np.log2(low)), np.ceil(np.log2(high)) + 1)
        smallest = np.diff(some)
        own = float(
            np.median(smallest[smallest < 1.5 * smallest[smallest > low].min(initial=width)])
        )
        for step in np.sort(np.concatenate([candidates, powers, [own]]))[::-1]:
            if low <= step <= high and _multiples(some - some[0], float(step), precision):
                return float(step)
    return precision if single and precision > FINEST * width else 0.0


def _multiples(x: F64, step: float, precision: float) -> bool:
    off = np.abs(x / step - np.rint(x / step))
    return bool(np.mean(off <= max(NEAR, min(2.0 * precision / step, 0.25))) >= SHARE)


def _point_hashes(r: F64, seed: int) -> npt.NDArray[np.uint64]:
    """A number (n,) for each point (n, 3) that depends on its coordinates alone."""
    mixed = np.full(len(r), seed, np.uint64)
    for axis in range(3):
        mixed = hashes(mixed ^ (r[:, axis] + 0.0).view(np.uint64))
    return mixed


def dither(r: F64, steps: F64, seed: int) -> F64:
    """Points (n, 3) moved by up to half a step, evenly and by a hash of the point: the same in any
    order.
    """
    if not steps.any():
        return r
    mixed, out = _point_hashes(r, seed), r.copy()
    for axis in range(3):
        mixed = hashes(mixed + np.uint64(axis + 1))
        out[:, axis] += steps[axis] * ((mixed >> np.uint64(11)).astype(np.float64) * 2.0**-53 - 0.5)
    return out


def remove_dither_noise(noise: F64, steps: F64) -> F64:
    """Noise as it is in rounded points, from what :func:`dither` made of it."""
    if not steps.any():
        return noise
    added = float(np.mean(steps**2)) / 12.0  # of a normal in no direction in particular
    return np.asarray(np.sqrt(np.maximum(noise**2 - added, added)))


def shared_rounding(normal: F64, steps: F64, noise: F64, reach: F64) -> F64 | float:
    """Variance (k,) m² that rounding leaves in surfaces with normals (k, 3), and that no residual
    shows: a quiet surface that rises by less than a step within its ``reach`` (k,) moves as one.
    """
    if not steps.any():
        return 0.0
    out = np.zeros(len(normal))
    for axis in np.flatnonzero(steps):
        step = float(steps[axis])
        rise = reach * np.sqrt(np.maximum(1.0 - normal[:, axis] ** 2, 0.0))
        along = rise < step
        known = np.linspace(0.0, LOUD, 64)
        table = [rounding_variance(step, step * float(k)) for k in known]
        out[along] += np.interp(noise[along] / step, known, table)
    return out

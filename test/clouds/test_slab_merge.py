"""Two planes in one slab of more noise than believed are one; two surfaces close together stay
two.
"""

import numpy as np
import pytest

from ladar_volume.clouds.filter import cell_records, plane_em
from ladar_volume.clouds.filter.sharp_planes import nearest_planes

SIGMA, THRESHOLD = 0.02, 0.06
SEEDS = range(6)


def sheet(rng, n, noise, low=(-0.5, -0.5), high=(0.5, 0.5), up=0.0):
    """Points (n, 3) about a level plane between two corners."""
    return np.column_stack([rng.uniform(low, high, (n, 2)), rng.normal(up, noise, n)])


def two_planes(rng, x, gap, tilt=0.0):
    """Pieces of two nearly level planes about ``gap`` apart, and the labels of points (m, 3)."""
    pieces = cell_records.pieces_of(len(x))
    for k, sign in enumerate([1, -1]):
        n = np.array([sign * tilt, rng.normal(0.0, 0.1 * tilt), 1.0])
        pieces.planes[k, :3] = n / np.linalg.norm(n)
        pieces.planes[k, 3] = 0.5 * sign * gap
    nearest_planes(x, len(x), pieces.planes, 2, THRESHOLD**2, pieces.label)
    return pieces


def sample_of(x):
    return cell_records.PointSample(x, len(x), len(x), SIGMA, THRESHOLD)


def mixed(x, label, axis):
    """Share of the belonging's variance between squares, by means of its 0 and 1 over a table."""
    use = (label == 0) | (label == 1)
    y, u = (label[use] == 1).astype(float), np.delete(x[use], axis, axis=1)
    low, high = u.min(axis=0), u.max(axis=0)
    cell = np.clip(np.floor((u - low) / (high - low) * 4), 0, 3) @ [4, 1]
    names = np.unique(cell)
    means = {c: y[cell == c].mean() for c in names}
    between = np.var([means[c] for c in cell])
    return between <= (0.2 + (len(names) - 1) / len(y)) * np.var(y)


def one_slab(x, planes, label):
    """By histogram of the heights between the planes, from their description."""
    p, q = planes[0], planes[1] * np.sign(planes[0, :3] @ planes[1, :3])
    use = label[: len(x)] >= 0
    d, e = x[use] @ p[:3] - p[3], x[use] @ q[:3] - q[3]
    gap = d - e
    if np.linalg.norm(np.cross(p[:3], q[:3])) >= 0.1 or np.abs(gap).max() > 4 * SIGMA:
        return False
    at = (d / gap)[np.abs(gap) > 2 * SIGMA]
    low, middle, high = (np.histogram(at, [a, a + 1 / 3])[0][0] for a in (-1 / 6, 1 / 3, 5 / 6))
    filled = middle >= 0.8 * 0.5 * (low + high)
    return filled and mixed(x, label[: len(x)], int(np.abs(p[:3]).argmax()))


@pytest.mark.parametrize("seed", range(40))
def test_one_slab_is_its_description(seed):
    """On random slabs, steps and double sheets near where the answer changes."""
    rng = np.random.default_rng(seed)
    gap, n = rng.uniform(1.0, 4.5) * SIGMA, 300
    noise = rng.uniform(0.5, 1.6) * SIGMA
    apart = seed % 3 == 0
    x = np.concatenate(
        [
            sheet(rng, n, noise, up=0.5 * gap, low=(-0.1 if apart else -0.5, -0.5)),
            sheet(rng, n, noise, up=-0.5 * gap, high=(0.1 if apart else 0.5, 0.5)),
        ]
    )
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pieces = two_planes(rng, x, gap, rng.uniform(0.0, 0.05))
    pieces.planes[:2, :3] = pieces.planes[:2, :3] @ turn.T
    pieces.planes[1] *= rng.choice([-1, 1])
    x = np.ascontiguousarray(x @ turn.T)
    told = plane_em.one_slab(sample_of(x), pieces, 0, 1)
    assert told == one_slab(x, pieces.planes, pieces.label)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_slab_of_more_noise_than_believed_is_one_plane(seed):
    """Half as much noise again; the planes cross or lie above each other."""
    rng = np.random.default_rng(seed)
    x = sheet(rng, 400, 1.5 * SIGMA)
    for gap, tilt in ((2.2 * SIGMA, 0.01), (0.0, 0.03)):
        pieces = two_planes(rng, x, gap, tilt)
        assert plane_em.merge_slabs(sample_of(x), pieces, 2) == 1
        near = pieces.label == 0
        design = np.column_stack([np.ones(near.sum()), x[near, :2]])
        height, *slope = np.linalg.lstsq(design, x[near, 2], rcond=None)[0]
        plane = pieces.planes[0] / pieces.planes[0, 2]
        assert plane[3] == pytest.approx(height, abs=1e-4)
        assert plane[:2] == pytest.approx(-np.array(slope), abs=5e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_two_surfaces_stay_two(seed):
    """A step of three sigma; a strip three sigma above the ground around it; two sheets above each
    other, 3.5 sigma apart.
    """
    rng = np.random.default_rng(seed)
    up = 3.0 * SIGMA
    step = [sheet(rng, 300, SIGMA, low=(0.0, -0.5), up=up), sheet(rng, 300, SIGMA, high=(0.0, 0.5))]
    strip = sheet(rng, 600, SIGMA)
    strip[np.abs(strip[:, 0]) < 0.15, 2] += up
    double = [sheet(rng, 300, SIGMA, up=3.5 * SIGMA), sheet(rng, 300, SIGMA)]
    for x, gap in ((np.concatenate(step), up), (strip, up), (np.concatenate(double), 3.5 * SIGMA)):
        shifted = x - [0.0, 0.0, 0.5 * gap]
        pieces = two_planes(rng, shifted, gap)
        assert plane_em.merge_slabs(sample_of(shifted), pieces, 2) == 2

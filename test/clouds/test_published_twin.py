"""The sweep, its random samples and its edges against plain numpy written from the description,
point by point.
"""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from ladar_volume.clouds.filter.filter_result import REASONS
from ladar_volume.clouds.published import random_samples
from ladar_volume.clouds.published.plane_facets import ON_EDGE, PARALLEL
from ladar_volume.clouds.published.published_filter import (
    PublishedParameters,
    filter_published,
    inflation,
)
from ladar_volume.clouds.published.published_records import Sampler, Sampling
from ladar_volume.clouds.published.published_sweep import BAND
from ladar_volume.rmls.patch_fit import MAD

KEPT, OUTLIER, FEW, NONE, BEYOND = range(5)
WORD = (1 << 64) - 1


def mix(x):
    x = ((x ^ (x >> 30)) * 0xBF58476D1CE4E5B9) & WORD
    x = ((x ^ (x >> 27)) * 0x94D049BB133111EB) & WORD
    return x ^ (x >> 31)


class Draws:
    """Random samples: one stream per neighbourhood, one permutation per call."""

    def __init__(self, state):
        self.state = state

    def samples(self, n, k):
        pick = list(range(n))
        while True:
            for a in range(k):
                self.state = (self.state + 0x9E3779B97F4A7C15) & WORD
                b = a + mix(self.state) % (n - a)
                pick[a], pick[b] = pick[b], pick[a]
            yield pick[:k]


def plane_through(x):
    """(normal, offset) by cross product for three points, by the least singular direction for more;
    None where they are in line.
    """
    if len(x) == 3:
        u, v = x[1] - x[0], x[2] - x[0]
        n = np.cross(u, v)
        if not np.linalg.norm(n) > 0.2 * np.linalg.norm(u) * np.linalg.norm(v):
            return None
        n /= np.linalg.norm(n)
        return n, n @ x[0]
    mean = x.mean(axis=0)
    value, vector = np.linalg.eigh((x - mean).T @ (x - mean))
    return None if not value[1] > 1e-12 * value[2] else (vector[:, 0], vector[:, 0] @ mean)


def off(x, plane):
    return x @ plane[0] - plane[1]


def sampled(x, p, draws):
    """Best plane of the trials, its robust sigma and how many trials were made."""
    best, found, needed, made = np.inf, None, np.inf, 0
    samples = draws.samples(len(x), p.sample_size)
    while made < p.trials and made < needed and p.sample_size <= len(x):
        made += 1
        plane = plane_through(x[next(samples)])
        if plane is None:
            continue
        d = np.abs(off(x, plane))
        score = (
            max(np.sort(d)[len(d) // 2], 1e-12 * np.abs(x).sum(axis=1).max())
            if p.start == "lmeds"
            else np.minimum(d**2, p.ransac_threshold_m**2).sum()
        )
        if score < best:
            best, found = score, plane
            share = np.mean(d <= (2.5 * MAD * best if p.start == "lmeds" else p.ransac_threshold_m))
            good = share**p.sample_size
            needed = (
                np.inf
                if p.confidence == 1 or good == 0
                else 1
                if good == 1
                else np.log(1 - p.confidence) / np.log1p(-good)
            )
    if found is None:
        return None, -1.0, made
    d = np.sort(np.abs(off(x, found)))
    if p.start == "ransac":
        d = d[d <= p.ransac_threshold_m]
    return found, MAD * (1 + 5 / (len(d) - 3)) * d[len(d) // 2] if len(d) > 3 else -1.0, made


def limit(sigma, p):
    return p.threshold_m or max(p.outlier_sigmas * sigma, 1e-7 * p.radius_m)


def settled(x, planes, sigma, adapt, p):
    """Nearest plane within the threshold, least squares, again, until nothing changes."""
    threshold, before = limit(sigma, p), None
    planes = list(planes)
    for _ in range(p.refit_iterations):
        d = np.abs([off(x, plane) for plane in planes])
        label = np.where(d.min(axis=0) <= threshold, d.argmin(axis=0), -1)
        if before is not None and np.array_equal(label, before):
            break
        before = label
        square = free = 0
        for k in range(len(planes)):
            own = x[label == k]
            if len(own) < p.min_points or (plane := plane_through(own)) is None:
                return None
            planes[k] = plane
            square += (off(own, plane) ** 2).sum()
            free += len(own) - 3
        sigma = np.sqrt(square / free)
        threshold = limit(sigma, p) if adapt else threshold
    return planes, sigma, threshold, label


def facets(x, p, draws):
    rest, start, first, made = np.arange(len(x)), [], None, 0
    while (
        len(start) < 3
        and len(rest) >= p.min_points
        and (not start or len(rest) > p.edges_threshold * len(x))
    ):
        plane, sigma, more = sampled(x[rest], p, draws)
        made += more
        fit = None if sigma < 0 else settled(x[rest], [plane], sigma, False, p)
        if fit is None:
            break
        (plane,), sigma, threshold, _ = fit
        left = rest[np.abs(off(x[rest], plane)) > threshold]
        if start and len(rest) - len(left) <= p.edges_threshold * len(x):
            break
        first = sigma if first is None else first
        start.append(plane)
        rest = left
    while start:
        fit = settled(x, start, first, True, p)
        if fit is not None:
            return fit, made
        start.pop()
    return None, made


def halves(x, planes, label):
    side = np.zeros((len(planes), len(planes)), int)
    for a, (n, _) in enumerate(planes):
        for b, (other, _) in enumerate(planes):
            if a != b and 1 - (n @ other) ** 2 >= PARALLEL**2:
                above = off(x[label == a], planes[b]) > 0
                side[a, b] = np.sign(int(above.sum()) - int((~above).sum()))
    return side


def on_half_plane(x, a, planes, side):
    """The nearest point to x of plane a within the halves, by trying its foot, the feet on its
    edges and its vertices.
    """
    others = [b for b in range(len(planes)) if side[a, b]]
    best, where = np.inf, None
    for active in [[], *([b] for b in others), others if len(others) == 2 else []]:
        N = np.array([planes[k][0] for k in [a, *active]])
        o = np.array([planes[k][1] for k in [a, *active]])
        q = x - np.linalg.pinv(N) @ (N @ x - o)
        if (
            all(side[a, b] * off(q, planes[b]) > -1e-7 for b in others)
            and np.linalg.norm(q - x) < best
        ):
            best, where = np.linalg.norm(q - x), q
    return best, where


def goes_to(x, planes, side, snap):
    """(plane, distance, place, beyond, whether two planes share the place and may both claim
    it).
    """
    pieces = [on_half_plane(x, a, planes, side) for a in range(len(planes))]
    a = int(np.argmin([d for d, _ in pieces]))
    d, at = pieces[a]
    if snap:
        return a, d, at, False, sum(abs(other - d) < 1e-9 for other, _ in pieces) > 1
    a = int(np.argmin([abs(off(x, plane)) for plane in planes]))
    at = x - off(x, planes[a]) * planes[a][0]
    beyond = any(side[a, b] * off(at, planes[b]) < -ON_EDGE for b in range(len(planes)))
    return a, d if beyond else abs(off(x, planes[a])), at, beyond, False


def twin(r, p):
    """Algorithm 1 for degree 1: (positions, variances without inflation, NaN on edges, reasons,
    inflation, trials, fits).
    """
    n = len(r)
    local = r - r.mean(axis=0)
    cell = np.floor(local / p.radius_m)
    order = np.lexsort(
        (local[:, 2], local[:, 1], local[:, 0], cell[:, 2], cell[:, 1], cell[:, 0])
    )  # the order neighbours are listed in
    place = np.argsort(order)
    tree = cKDTree(local[order])
    q, variance, reason = np.zeros((n, 3)), np.zeros(n), np.full(n, FEW)
    inliers = band = made = fits = 0
    visit = np.lexsort((*local.T, local.sum(axis=1))) if p.sort else np.arange(n)
    for rank, at in enumerate(visit):
        if reason[at] in (KEPT, BEYOND):
            continue
        near = order[np.sort(tree.query_ball_point(local[order][place[at]], 2 * p.radius_m))]
        x = local[near] - local[at]
        fresh = [
            i
            for i, y in zip(near, x, strict=True)
            if y @ y <= p.radius_m**2 and reason[i] not in (KEPT, BEYOND)
        ]
        if len(fresh) < p.min_points:
            continue
        fit, more = facets(x, p, Draws(mix(rank ^ mix(p.seed))))
        made += more
        inside = False
        if fit is not None:
            planes, sigma, threshold, label = fit
            d = np.abs([off(x, plane) for plane in planes]).min(axis=0)
            inside = np.count_nonzero(d <= threshold) >= p.min_share * len(x)
        if not inside:
            for i in fresh:
                reason[i] = NONE if reason[i] == FEW else reason[i]
            continue
        fits += 1
        inliers += np.count_nonzero(d <= threshold)
        band += np.count_nonzero(np.abs(d - threshold) <= BAND * threshold)
        side = halves(x, planes, label)
        for i in fresh:
            a, away, to, beyond, shared = goes_to(
                local[i] - local[at], planes, side, p.edge == "snap"
            )
            reason[i] = OUTLIER if away > threshold else BEYOND if beyond else KEPT
            if reason[i] == KEPT:
                q[i] = to + local[at]
                own = x[label == a]
                X = np.column_stack([np.ones(len(own)), tangential(own, planes[a])])
                row = np.concatenate([[1.0], tangential(to[None], planes[a])[0]])
                variance[i] = np.nan if shared else sigma**2 * row @ np.linalg.inv(X.T @ X) @ row
    return q + r.mean(axis=0), variance, reason, inflation(inliers, band), made, fits


def tangential(x, plane):
    """Coordinates (n, 2) along a plane: the variance of its height there is that of a linear
    regression.
    """
    return x @ np.linalg.svd(plane[0][None])[2][1:].T


def scene(kind):
    rng = np.random.default_rng(21)
    n = 700
    if kind == "plane":
        r = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), rng.normal(0, 0.004, n)])
        r[:150, 2] += rng.uniform(-0.3, 0.3, 150)
    elif kind == "corner":
        r = rng.uniform(0, 0.5, (n, 3))
        r[np.arange(n), np.arange(n) % 3] = rng.normal(0, 0.004, n)
    elif kind == "edge":
        r = np.column_stack([rng.uniform(-0.5, 0.5, (n, 2)), rng.normal(0, 0.004, n)])
        r[::2, 2] += np.abs(r[::2, 0])
        r[::2, 0] = rng.normal(0, 0.004, len(r[::2]))
    else:
        r = np.concatenate(
            [
                rng.uniform(-1, 1, (150, 3)),
                np.linspace(0, 0.4, 60)[:, None] * [[1, 1, 1]],
                np.zeros((30, 3)),
            ]
        )
    return Rotation.from_rotvec([0.3, 0.5, -0.8]).apply(r) + np.array([100.0, -50.0, 7.0])


@pytest.mark.parametrize("kind", ["plane", "edge", "corner", "junk"])
@pytest.mark.parametrize("start", ["lmeds", "ransac"])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"threshold_m": 0.0, "edge": "remove"},
        {"sample_size": 3, "sort": False},
        {"sample_size": 7, "confidence": 1.0, "min_share": 0.0},
    ],
)
def test_the_sweep_is_its_twin(kind, start, changes):
    r = scene(kind)
    p = PublishedParameters(
        **{
            "radius_m": 0.2,
            "threshold_m": 0.015,
            "ransac_threshold_m": 0.008,
            "trials": 25,
            "min_points": 8,
            "start": start,
            "seed": 3,
            **changes,
        }
    )
    result = filter_published(r, p)
    q, variance, reason, factor, made, fits = twin(r, p)
    assert np.array_equal(result.index, np.flatnonzero(reason == KEPT))
    assert np.array_equal(result.reason, reason[reason != KEPT])
    assert np.abs(result.r - q[result.index]).max(initial=0.0) < 1e-8
    assert result.report["fits"] == fits
    if (
        kind != "junk"
    ):  # where all residuals are rounding, so is the share of inliers that ends the trials
        assert result.report["trials_per_fit"] == pytest.approx(made / fits)
    assert result.report["variance_inflation"] == pytest.approx(factor)
    clear = ~np.isnan(
        variance[result.index]
    )  # on an edge the variance is that of one of its two planes
    # duplicates and points on a line lie exactly on their plane: only rounding is left of the
    # variance
    assert np.allclose(
        result.sigma[clear] ** 2, factor * variance[result.index][clear], rtol=1e-6, atol=1e-24
    )
    assert clear.mean() > 0.9
    assert fits > 2 and len(result.index) > 0.3 * len(r)


def test_every_reason_occurs_in_what_the_twin_covers():
    seen = set()
    for kind in ("plane", "edge", "corner", "junk"):
        for sample in (3, 4):
            p = PublishedParameters(
                radius_m=0.2,
                threshold_m=0.015,
                ransac_threshold_m=0.008,
                trials=25,
                min_points=8,
                edge="remove",
                seed=3,
                sample_size=sample,
                start="lmeds",
            )
            seen |= set(np.array(REASONS)[filter_published(scene(kind), p).reason])
    assert seen == {"outlier", "few_neighbours", "no_surface", "beyond_edge"}


@pytest.mark.parametrize("ransac", [False, True])
@pytest.mark.parametrize("confidence", [0.9, 1.0])
def test_sampled_quadrics_are_their_twin(ransac, confidence):
    rng = np.random.default_rng(4)
    m, k, threshold = 120, 7, 0.02
    uvw = np.zeros((4, m))
    uvw[:2] = rng.uniform(-1, 1, (2, m))
    basis = np.stack(
        [np.ones(m), uvw[0], uvw[1], uvw[0] ** 2, uvw[0] * uvw[1], uvw[1] ** 2], axis=1
    )
    uvw[2] = basis @ [0.01, 0.02, -0.03, 0.2, 0.1, -0.15] + rng.normal(0, 0.005, m)
    uvw[2, :40] += rng.uniform(0, 1, 40)
    best, needed, made, found = np.inf, np.inf, -1, None
    samples = Draws(77).samples(m, k)
    while made < 60 and made < needed:
        made += 1
        pick = next(samples) if made else None
        trial = np.linalg.lstsq(basis[pick], uvw[2, pick], rcond=None)[0] if made else np.zeros(6)
        d = np.abs(uvw[2] - basis @ trial)
        score = (np.minimum(d, threshold) ** 2).sum() if ransac else np.sort(d)[m // 2]
        if score < best:
            best, found = score, trial
            good = np.mean(d <= (threshold if ransac else 2.5 * MAD * best)) ** k
            needed = np.log(1 - confidence) / np.log1p(-good) if made and confidence < 1 else np.inf
    d = np.sort(np.abs(uvw[2] - basis @ found))
    d = d[d <= threshold] if ransac else d
    beta, state = np.zeros(6), np.array([77], np.uint64)
    sampler = Sampler(state, np.empty(m, np.int64), np.empty(m))
    sampling = Sampling(k, 60, ransac, threshold, confidence)
    sigma, count = random_samples.sampled_quadric(uvw, m, sampling, sampler, beta)
    assert count == made and np.allclose(beta, found, atol=1e-9)
    assert sigma == pytest.approx(MAD * (1 + 5 / (len(d) - 6)) * d[len(d) // 2])


def test_draws_are_uniform_and_without_repeats():
    state, pick = np.array([5], np.uint64), np.arange(10)
    counts = np.zeros(10)
    for _ in range(4000):
        random_samples.draw_sample(state, pick, 10, 3)
        assert len(set(pick[:3])) == 3 and set(pick) == set(range(10))
        counts[pick[:3]] += 1
    assert np.abs(counts / 4000 - 0.3).max() < 0.03


def test_trials_follow_the_share_of_inliers():
    assert random_samples.trials_needed(0.5, 4, 0.99) == pytest.approx(
        np.log(0.01) / np.log(1 - 0.5**4)
    )
    assert (
        random_samples.trials_needed(0.5, 20, 0.99) > 1e6
    )  # twenty points per sample cannot survive one outlier in two
    assert random_samples.trials_needed(1.0, 4, 0.99) == 1 and random_samples.trials_needed(
        0.0, 4, 0.99
    ) == np.inf == random_samples.trials_needed(0.9, 4, 1.0)

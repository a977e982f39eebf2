"""Whether the returns of a survey agree with each other as its budget says.

A patch is seen by several beams in several passes. About its surface they scatter by the noise of
each return, by the errors of the beams, and by what position, attitude and boresight do differently
to the passes: for the effects ``u_e`` of a source on a patch's time bins e (one standard deviation,
three directions) with correlations ``rho_ef`` the mean square about the patch is
``Σ u_e·u_e / B − Σ rho_ef u_e·u_f / B²``. The median patch is held against it. What lifts all
passes alike, such as a shift of the datum or a vertical lever arm, no such test can see.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtrc

from ladar_volume.math.kernels import kernel
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import F64, I64, Agreement, Bool, PatchTable, SourceAgreement
from ladar_volume.uncertainty.navigation_sum import NavigationBins
from ladar_volume.uncertainty.pass_differences import (
    pass_differences,
    scatter_of_looks,
    scatter_within_bins,
    times_root,
)
from ladar_volume.uncertainty.variance_components import (
    UNLIKELY,
    Component,
    variance_components,
)

#: Patches that are asked at most; fewest that answer; fewest returns of one, and least upward
#: component of its normal: what a wall scatters is where it is met.
ASKED, FEWEST, RETURNS, UPWARD = 250, 30, 20, 0.7
#: Roughness of a surface within a patch that is no trouble, m.
GRAIN_M = 0.01
#: What the ground scatters more than a body where it is overgrown, m, at least; and what a body
#: does where no ground is to compare with.
GRASS_M, ROUGH_M = 0.009, 0.015
#: Least share of what the body scatters beyond the budget that the ground scatters more: what is
#: wrong with a budget scatters slopes more than level ground, and hides grass.
OF_SLOPES = 0.5
#: Probability below which a budget is refuted, and by how much its variances then are too small at
#: least, and are scaled at most.
REFUTED, LEAST, MOST = 1e-2, 2.25, 1000.0


#: Sources that one test judges together.
GROUPS = {
    "beams": ("beams",),
    "boresight": ("boresight",),
    "lever_arms": ("lever_laser", "lever_antenna"),
    "attitude": ("attitude",),
    "position": ("position",),
    "clock": (),
}
#: A group is judged whose part of the predicted mean square is no less than this.
VISIBLE = 0.02


#: Passes lie apart sideways where the direction of the patches explains so much of the scatter of
#: these, the shift is no less than so many metres, and across it less than this part of the square.
#: Patches that scatter more than so many of the others are left out.
SHIFTED, SHIFT_M, ROUND, USUAL = 0.25, 0.06, 0.3, 0.98
#: Root mean square of what a plane leaves of a curve, and a fit of second degree of a cone: in
#: radii and in the mean turn of the normals within a radius, or its square.
MISFIT = (0.2, 0.5)
#: A fit bends over an edge so many distances of neighbouring patches beside a steep face.
BENDS = 3.0


@kernel
def dispersion(start: I64, t_s: F64, u: F64, shares: tuple[float, float, float]) -> F64:
    """Mean squares (k,) about the mean of effects u (l, 3) of the bins of each of k patches, from
    start (k + 1,) on, at times (l,) s. shares : constant, and white part, and correlation time (s)
    of the rest.
    """
    constant, white, tau = shares
    out = np.zeros(len(start) - 1)
    for a in range(len(out)):
        n = start[a + 1] - start[a]
        own, both = 0.0, 0.0
        for e in range(start[a], start[a + 1]):
            square = u[e, 0] ** 2 + u[e, 1] ** 2 + u[e, 2] ** 2
            own += square
            both += square
            for f in range(start[a], e):
                rho = constant + (1.0 - constant - white) * math.exp(-abs(t_s[e] - t_s[f]) / tau)
                both += 2.0 * rho * (u[e, 0] * u[f, 0] + u[e, 1] * u[f, 1] + u[e, 2] * u[f, 2])
        out[a] = own / n - both / (n * n)
    return out


def select_patches(patches: PatchTable) -> I64:
    """Patches (k,) that tell something, spread evenly."""
    bins = np.diff(patches.nav_start)
    good = (bins >= 2) & (patches.used >= RETURNS) & (np.abs(patches.normal[:, 2]) > UPWARD)
    rows = np.flatnonzero(good).astype(np.int64)
    return rows[:: max(1, math.ceil(len(rows) / ASKED))]


def scatter_by_source(
    patches: PatchTable, rows: I64, nav: NavigationBins, b: BudgetParameters
) -> dict[str, F64]:
    """What each source does to the mean squares (k,) m² of patches ``rows`` (k,) about their
    surfaces.
    """
    count = np.diff(patches.nav_start)[rows]
    start = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    entry = np.repeat(patches.nav_start[rows] - start[:-1], count) + np.arange(start[-1])
    owner, bins = np.repeat(rows, count), patches.nav_bin[entry]
    index, states, C, pose = nav.sums()
    at = np.minimum(np.searchsorted(index, bins), len(index) - 1)
    C, pose = C[at] / states[at, None, None], pose[at] / states[at, None, None]
    n, R = patches.normal[owner], pose[:, 1:]
    m = np.einsum("lij,li->lj", R, n)
    arm = np.einsum("lij,li->lj", R, patches.centre[owner] - pose[:, 0])
    turned, far = np.cross(arm, m), np.linalg.norm(arm, axis=1)
    cosine = (arm * m).sum(axis=1) / np.maximum(far, 1e-9)
    across = far**2 * np.maximum(1.0 - cosine**2, 0.0)
    t_s = (bins - bins.min()) * (nav.bin_ns * 1e-9)

    def mean(of: F64) -> F64:
        return np.add.reduceat(of, start[:-1]) / count

    angle = (0.25 * b.beam_divergence_rad) ** 2
    angle += 0.5 * (b.azimuth_noise_rad**2 + b.vertical_noise_rad**2)
    constant = (1.0, 0.0, 1.0)
    attitude = (b.attitude_bias_fraction, b.attitude_white_fraction, b.tau_attitude_s)
    position = (b.position_bias_fraction, b.position_white_fraction, b.tau_position_s)
    return {
        "noise": mean((b.range_noise_m * cosine) ** 2 + across * angle),
        "beams": mean(
            (b.beam_range_sigma_m * cosine) ** 2 + 0.5 * across * b.beam_vertical_sigma_rad**2
        ),
        "boresight": dispersion(start, t_s, turned * np.array(b.boresight_sigma_rad), constant),
        "lever_laser": dispersion(start, t_s, m * np.array(b.lever_laser_sigma_m), constant),
        "lever_antenna": dispersion(start, t_s, m * np.array(b.lever_antenna_sigma_m), constant),
        "attitude": dispersion(start, t_s, times_root(C[:, 3:, 3:], turned), attitude),
        "position": dispersion(start, t_s, times_root(C[:, :3, :3], n), position),
    }


def degrees_of_freedom(source: str, span_s: float, b: BudgetParameters) -> float:
    """Independent errors of a source that passes tell apart, about: two for each of 16 beams, two
    directions of a constant, and of what wanders two times two and a half, as for the square of a
    random walk about its mean, and more for every correlation time.
    """
    if source == "beams":
        return 32.0
    if source in ("attitude", "position"):
        tau = b.tau_attitude_s if source == "attitude" else b.tau_position_s
        return 5.0 + 2.0 * span_s / tau
    return 2.0


class Scatter(NamedTuple):
    """rows : (k,) patches that were asked · square : (k,) m², mean squares about their surfaces ·
    source : (k,) m² by source, what the budget says of them
    """

    rows: I64
    square: F64
    source: dict[str, F64]

    def of(self, some: Bool) -> Scatter:
        """Of some of the patches (k,)."""
        source = {name: part[some] for name, part in self.source.items()}
        return Scatter(self.rows[some], self.square[some], source)

    def within_bins(self, patches: PatchTable) -> Scatter | None:
        """Of the returns about the mean of their time bins, of which noise and beams alone say
        anything; None where that is not known.
        """
        square = scatter_within_bins(patches, self.rows)
        source = {name: self.source[name] for name in ("noise", "beams")}
        return None if square is None else Scatter(self.rows, square, source)

    def of_looks(self, patches: PatchTable) -> Scatter | None:
        """Of each return beside what differs between time bins and between beams, of which noise
        alone says anything; None where that is not known.
        """
        square = scatter_of_looks(patches, self.rows)
        source = {"noise": self.source["noise"]}
        return None if square is None else Scatter(self.rows, square, source)

    def roughness(self, patches: PatchTable) -> F64:
        """Mean squares (k,) m² of each return's own: what returns scatter within their bins beside
        the beams' part, by their degrees of freedom, and no less than noise and grain.
        """
        least: F64 = self.source["noise"] + GRAIN_M**2
        within = self.within_bins(patches)
        if within is None:
            return least
        used = patches.used[self.rows].astype(np.float64)
        bins = np.diff(patches.nav_start)[self.rows]
        free = used / np.maximum(used - bins, 0.5 * used)
        return np.maximum(within.square * free - self.source["beams"], least)

    @property
    def unexplained_m2(self) -> F64:
        """What the budget does not explain, (k,) m²; below zero where it says too much."""
        out: F64 = self.square - np.sum(list(self.source.values()), axis=0)
        return out


def patch_scatter(patches: PatchTable, nav: NavigationBins, b: BudgetParameters) -> Scatter | None:
    """The residuals of patches and what they should be; None where too few patches are seen more
    than once.
    """
    rows = select_patches(patches)
    if len(rows) < FEWEST:
        return None
    return Scatter(rows, patches.sigma[rows] ** 2, scatter_by_source(patches, rows, nav, b))


def pass_agreement(
    found: Scatter,
    patches: PatchTable,
    nav: NavigationBins,
    b: BudgetParameters,
    max_fix_gap_s: float,
) -> Agreement | None:
    """How the residuals of the median patch, and what passes and beams differ by, compare with the
    budget; None where nothing is shared. max_fix_gap_s : longest interval between fixes.
    """
    part = {name: float(np.median(of)) for name, of in found.source.items()}
    square, noise = float(np.median(found.square)), part.pop("noise")
    shared = sum(part.values())
    if not shared > 0.0:
        return None
    rough = found.roughness(patches)
    left = float(np.median(found.square - rough))
    factor = max(0.0, left) / shared
    span_s = float(np.ptp(patches.nav_bin)) * nav.bin_ns * 1e-9
    # Satterthwaite: a sum of chi-squares as one
    n = shared**2 / sum(v**2 / degrees_of_freedom(name, span_s, b) for name, v in part.items())
    p = float(chdtrc(n, factor * n))
    components: dict[str, Component] = {}
    for told in pass_differences(patches, nav, b, max_fix_gap_s):
        components |= variance_components(told)
    sources = tuple(
        with_component(s, components.get(s.name)) for s in source_agreement(part, left, span_s, b)
    )
    # residuals may be too large where no group is to blame: rough surfaces are filtered worse
    refuted = (p < REFUTED and factor > LEAST) or any(s.scale > 1.0 for s in sources)
    within = found.within_bins(patches)
    if within is not None:
        own = float(np.median(within.square - within.source["beams"]))
        sources = (*sources, noise_agreement(own, noise, len(within.rows)))
    smooth = ~beside_steep_faces(patches.centre, patches.normal)[found.rows]
    # what returns scatter within their passes is no shift between these
    apart = found.unexplained_m2 + found.source["noise"] - rough
    shift = sideways_shift(found.of(smooth), apart[smooth], patches.normal)
    predicted = math.sqrt(float(np.median(rough)) + shared)
    return Agreement(math.sqrt(square), predicted, factor, n, p, refuted, sources, *shift)


def source_agreement(
    part: dict[str, float], left: float, span_s: float, b: BudgetParameters
) -> tuple[SourceAgreement, ...]:
    """Each group of sources held against what of the median square (m²) noise and roughness leave,
    the other groups being as the budget says. part : of each source, m² · span_s : of the survey.
    """
    total, out = sum(part.values()), []
    for name, members in GROUPS.items():
        own = max(sum(part[member] for member in members), 0.0)  # rounding may leave less
        visible = own > 0.0 and own >= VISIBLE * total
        factor = max(0.0, left - (total - own)) / own if visible else float("nan")
        n = degrees_of_freedom(name, span_s, b)
        p = float(chdtrc(n, factor * n)) if visible else float("nan")
        out.append(SourceAgreement(name, math.sqrt(own), factor, n, p, visible))
    return tuple(out)


def noise_agreement(within_m2: float, noise_m2: float, patches: int) -> SourceAgreement:
    """The returns' noise held against what the median patch scatters within its bins, m², beside
    the beams' part. Roughness of a surface looks the same, and does the same to a volume; 1 cm of
    it is no trouble. patches : how many were asked
    """
    factor = max(0.0, within_m2 - GRAIN_M**2) / max(noise_m2, 1e-12)
    p = float(chdtrc(patches, factor * patches))
    scale = min(factor, MOST) if p < UNLIKELY and factor > LEAST else 1.0
    sigma = max(factor, 1.0) * math.sqrt(2.0 / patches)
    return SourceAgreement(
        "noise", math.sqrt(noise_m2), factor, float(patches), p, True, sigma, scale
    )


def with_component(source: SourceAgreement, found: Component | None) -> SourceAgreement:
    """A group with the variance component that signed differences of the passes give it, where
    these are known.
    """
    if found is None:
        return source
    return dataclasses.replace(
        source,
        factor=found.factor,
        freedom=found.freedom,
        p_value=found.p_value,
        visible=True,
        sigma=found.sigma,
        scale=min(max(1.0, found.factor), MOST) if found.freed else 1.0,
    )


def beside_steep_faces(centre: F64, normal: F64) -> Bool:
    """Which patches with centre and normal (m, 3) lie beside a steep one, (m,). Their normals lean
    where the fit bends over an edge, and scatter there by its shape: they tell nothing of a shift.
    """
    steep = np.abs(normal[:, 2]) <= UPWARD
    if not steep.any() or len(centre) < 2:
        return steep
    apart = float(np.median(np.asarray(cKDTree(centre).query(centre, 2)[0])[:, 1]))
    off = np.asarray(cKDTree(centre[steep]).query(centre)[0])
    beside: Bool = off <= BENDS * apart
    return beside


def plain_patches(centre: F64, normal: F64, asked: I64, radius_m: float, degree: int) -> Bool:
    """Which patches with centre and normal (m, 3) lie where the surface bends so little within the
    filter's radius that its shape scatters no return, (m,): not about the top of a cone, nor along
    crest and toe. All of them where too few of those asked (k,) are left. degree : of the filter's
    fit
    """
    m = len(centre)
    near, beside = cKDTree(centre).query_pairs(radius_m, output_type="ndarray").T
    turn = np.linalg.norm(normal[near] - normal[beside], axis=1)
    both = np.concatenate([near, beside])
    count = np.maximum(np.bincount(both, minlength=m), 1)
    mean = np.bincount(both, np.concatenate([turn, turn]), m) / count
    left_m = MISFIT[min(degree, 2) - 1] * radius_m * mean ** min(degree, 2)
    plain: Bool = left_m < 0.5 * GRASS_M
    return plain if np.count_nonzero(plain[asked]) >= FEWEST // 2 else np.ones(m, np.bool_)


def sideways_shift(found: Scatter, apart_m2: F64, normal: F64) -> tuple[float, float]:
    """By how much two halves of the passes lie apart sideways, m, and along which direction,
    degrees from east; 0 where they do not.

    A jump d of the positions adds ``q (1 − q) (d·n)²`` to the mean square of a patch with normal n
    of which it moves a share q: the form of the tensor ``d dᵀ / 4`` in n where q is a half. It is
    fitted, and its horizontal part has one axis. apart_m2 : (k,) m², what the mean squares of the
    patches have that budget and roughness do not explain · normal : (m, 3) of all patches.
    """
    if len(found.rows) < FEWEST:
        return 0.0, 0.0
    predicted = np.sum(list(found.source.values()), axis=0)
    weight = 1.0 / (predicted + GRAIN_M**2)
    y = apart_m2 * weight
    some = y <= np.quantile(y, USUAL)
    n, w = normal[found.rows[some]], weight[some]
    x, v, z = n.T
    X = w[:, None] * np.column_stack(
        [np.ones(len(n)), x * x, v * v, 2.0 * x * v, 2.0 * x * z, 2.0 * v * z]
    )
    level = w * float(w @ y[some]) / float(w @ w)
    fit = np.linalg.lstsq(X, y[some], rcond=None)[0]
    left, about = y[some] - X @ fit, y[some] - level
    if float(left @ left) > (1.0 - SHIFTED) * float(about @ about):
        return 0.0, 0.0
    up, east, north, both = fit[:4].tolist()
    size, axes = np.linalg.eigh(np.array([[up + east, both], [both, up + north]]))
    major = 2.0 * math.sqrt(max(float(size[1]), 0.0))
    if major < SHIFT_M or float(size[0]) > ROUND * float(size[1]):
        return 0.0, 0.0
    return major, math.degrees(math.atan2(float(axes[1, 1]), float(axes[0, 1])) % math.pi)


def cover_scatter(found: Scatter, covered: Bool, bare: Bool, share: float = 1.0) -> float:
    """By how much patches of the ground scatter more than those of the body, or the other way
    round, m: 0 where they do not by as much as grass does, and by so large a share of what bare
    ones scatter beyond the budget. covered, bare : (m,) of all patches.
    """
    left, on, off = found.unexplained_m2, covered[found.rows], bare[found.rows]
    on, off = on & ~off, off & ~on
    if min(np.count_nonzero(on), np.count_nonzero(off)) < FEWEST // 2:
        return 0.0
    rest = max(0.0, float(np.median(left[off])))  # where that is much, something else is wrong
    more = float(np.median(left[on])) - rest
    return math.sqrt(more) if more > max(GRASS_M**2, share * rest) else 0.0


def own_scatter(found: Scatter, body: Bool) -> float:
    """What patches of the body scatter beyond the budget, m, with no ground to compare with: 0
    where plants or rough material need not be the cause. body : (m,) of all patches.
    """
    left = found.unexplained_m2[body[found.rows]]
    if len(left) < FEWEST // 2:
        return 0.0
    more = float(np.median(left))
    return math.sqrt(more) if more > ROUGH_M**2 else 0.0

"""Self-calibration from overlapping strips: boresight, lever arms and clock offset by least squares
on planar patches.

Gauss-Newton: georeference with the current constants, find the patches that several strips saw,
solve for the corrections with navigation errors and beam offsets as nuisance (seed 004 section
5.1.2: "post processing of overlapping strips of LiDAR data over non-flat terrain"). Priors from the
budget always enter; what the strips cannot tell stays at its prior, and the result says so.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ladar_volume.calibration.flight import Flight, remap_returns
from ladar_volume.calibration.navigation_drift import Drift, drift
from ladar_volume.calibration.strip_adjustment import (
    Observations,
    Solution,
    drop_patches,
    observations,
    off_plane,
    solve,
)
from ladar_volume.calibration.strip_patches import OUTLIER_SIGMAS, fit_planes, overlap
from ladar_volume.georeference.error_budget import calibration_columns, independent_sigmas
from ladar_volume.math.packed_covariance import unpack
from ladar_volume.model.errors import CalibrationError
from ladar_volume.model.parameters import BudgetParameters
from ladar_volume.model.records import CAL_COLUMNS, F64, I64
from ladar_volume.model.survey_parameters import StripParameters

#: Columns that have a constant to be corrected: everything shared but the range bias.
CORRECTED: I64 = np.arange(1, len(CAL_COLUMNS))
#: Share of the prior sigma below which a constant counts as estimated, and above which it counts as
#: held at its prior.
ESTIMATED, HELD = 0.5, 0.9
#: Chi-square over its degrees of freedom up to which strips agree: flights that fit their budget
#: have 0.9 to 1.1 (curved patches, white noise of the fixes), those with errors three times the
#: budget's 1.2 to 1.4. With thousands of degrees of freedom a test would refuse them all.
AGREE = 1.2
_CONVERGED, _NOISE_STEADY, _MOST_STEPS = 1e-2, 0.01, 15
#: Patches are searched anew until a step is within one sigma, or this often.
_NEAR, _SEARCHING = 1.0, 6
#: Fewer patches are no net of observations but a coincidence.
_FEWEST = 20


@dataclass(frozen=True)
class StripCalibration:
    """What the strips say. Columns are those of ``error_budget.calibration_columns``: m, rad, s.

    theta : (c,) corrections of the constants (body rotation vector for the boresight), zero for
    columns that have none · prior, posterior : (c, c) before and after · C_cal : (c, c) for the
    budget of surveys that use the corrected constants · condition : ratio of the best to the worst
    determined direction, sigma over prior sigma · weakest : (10,) that direction, in units of the
    prior sigmas · noise : measured over budgeted noise of the returns · chi2, freedom : of the
    strips' disagreement, given the budget's navigation errors and priors · before_m, after_m : rms
    disagreement of strips on one patch, as read and corrected · patches, strips, returns,
    moved_patches (patches left out), steps : counts
    """

    names: tuple[str, ...]
    theta: F64
    prior: F64
    posterior: F64
    C_cal: F64
    condition: float
    weakest: F64
    noise: float
    chi2: float
    freedom: int
    before_m: float
    after_m: float
    patches: int
    strips: int
    returns: int
    moved_patches: int
    steps: int

    @property
    def agree(self) -> bool:
        """Whether the corrected strips agree within the budget, as far as patches that are not
        quite planes can tell.
        """
        return self.chi2 <= AGREE * self.freedom

    @property
    def beyond_prior(self) -> tuple[str, ...]:
        """Constants corrected by more than 3.5 sigma of their prior: the budget, or the recording,
        is not what it was taken for.
        """
        limit = OUTLIER_SIGMAS * np.sqrt(np.diag(self.prior))
        return tuple(self.names[k] for k in CORRECTED if abs(self.theta[k]) > limit[k] > 0.0)

    def status(self, column: int) -> str:
        """``fixed``, ``estimated``, ``improved`` or ``held at its prior``."""
        before, after = self.prior[column, column], self.posterior[column, column]
        if before == 0.0:
            return "fixed"
        share = float(np.sqrt(after / before))
        return (
            "estimated"
            if share < ESTIMATED
            else "improved"
            if share < HELD
            else "held at its prior"
        )


@dataclass(frozen=True)
class _Step:
    """One adjustment. noise : of the returns within strips, over the assumed · chi2, freedom : of
    the strips' disagreement with that noise · offset_m : rms distance of the strips from their
    common planes, before and after the step · membership : patch of every return of the flight, −1
    for none
    """

    solution: Solution
    patches: int
    strips: int
    returns: int
    noise: float
    chi2: float
    freedom: int
    offset_m: tuple[float, float]
    moved_patches: int
    membership: I64


@dataclass(frozen=True)
class _Problem:
    """What stays the same from step to step."""

    flight: Flight
    budget: BudgetParameters
    effects: Drift
    options: StripParameters
    active: I64
    beams: int
    precision: F64


def calibrate(
    flight: Flight, budget: BudgetParameters, prior: F64, options: StripParameters | None = None
) -> StripCalibration:
    """Corrections of a flight's constants. ``prior`` (c, c) is C_cal of the budget
    (``error_budget.calibration_covariance``); columns of zero variance stay as they are.

    Raises :class:`CalibrationError`: calibration_no_overlap, calibration_no_convergence,
    calibration_unobservable (no constant gains).
    """
    problem = _problem(flight, budget, prior, options or StripParameters())
    active, corrected = problem.active, np.isin(problem.active, CORRECTED)
    theta, noise, before_m, membership, moved = np.zeros(len(prior)), 1.0, np.nan, None, 0
    for number in range(1, _MOST_STEPS + 1):
        step = _step(problem, theta, noise, membership)
        before_m = step.offset_m[0] if number == 1 else before_m
        move = step.solution.x[: len(active)][corrected]
        theta[active[corrected]] += move
        size = float(move @ np.linalg.solve(step.solution.C[np.ix_(corrected, corrected)], move))
        if size < _CONVERGED and abs(step.noise - 1.0) < _NOISE_STEADY:
            step = dataclasses.replace(step, moved_patches=moved + step.moved_patches)
            return _result(problem, step, theta, prior, noise, before_m, number)
        noise *= step.noise
        if membership is None and (size < _NEAR or number == _SEARCHING):
            # from here on the same returns, so that the steps can end
            membership, moved = step.membership, step.moved_patches
    raise CalibrationError(
        (
            f"no convergence in {_MOST_STEPS} steps: the last one moved the constants by "
            f"{np.sqrt(size):.2g} sigma"
        ),
        reason="calibration_no_convergence",
        value=size,
    )


def _problem(
    flight: Flight, budget: BudgetParameters, prior: F64, options: StripParameters
) -> _Problem:
    """What stays the same from step to step. Raises :class:`CalibrationError` where no constant is
    to be estimated.
    """
    active = np.flatnonzero(np.diag(prior) > 0.0)
    if not np.isin(active, CORRECTED).any():
        raise CalibrationError(
            "every constant has a prior sigma of zero: nothing is to be estimated",
            reason="calibration_unobservable",
        )
    beams = (len(prior) - len(CAL_COLUMNS)) // 2
    precision = np.asarray(np.linalg.inv(prior[np.ix_(active, active)]), np.float64)
    return _Problem(flight, budget, drift(flight, budget), options, active, beams, precision)


def _step(p: _Problem, theta: F64, noise: float, membership: I64 | None) -> _Step:
    points, geometry, index = remap_returns(p.flight, theta, independent_sigmas(p.budget))
    C, strip = unpack(points.C_ind), p.flight.strip[geometry.state]
    limits = (p.options.edge_m, p.options.min_points, p.options.max_patches)
    if membership is None:
        # limits never shrink below the budget's noise: a cut that lowers the noise that sets the
        # cut would run away
        found = overlap(points.r_map, strip, max(1.0, noise) ** 2 * C, *limits)
    else:
        point = np.flatnonzero(membership[index] >= 0)
        found = fit_planes(points.r_map, strip, point, membership[index][point], *limits)
    if len(found.normal) < _FEWEST:
        raise CalibrationError(
            (
                f"only {len(found.normal)} patches were seen by two strips, {_FEWEST} are "
                "needed: strips must overlap"
            ),
            reason="calibration_no_overlap",
            value=len(found.normal),
        )
    normal = found.normal[found.patch]
    sigma = noise * np.sqrt(np.einsum("ni,nij,nj->n", normal, C[found.point], normal))
    o = observations(points, geometry, found, p.effects, sigma)
    solution = solve(o, p.effects, p.active, p.beams, p.precision, theta[p.active])
    total = int(o.patch.max()) + 1
    moved = _displaced_patches(o, solution.residual)
    if len(moved):
        o = drop_patches(o, moved)
        solution = solve(o, p.effects, p.active, p.beams, p.precision, theta[p.active])
    belongs = np.full(len(p.flight.t_ns), -1, np.int64)
    kept = ~np.isin(found.patch, moved)
    belongs[index[found.point[kept]]] = found.patch[kept]
    return _step_statistics(
        o, solution, total - len(moved), len(np.unique(found.strip_of)), len(moved), belongs
    )


def _displaced_patches(o: Observations, residual: F64) -> I64:
    """Patches on which a strip lies farther from the others than noise, or the usual disagreement,
    explains: something moved there.
    """
    count = np.bincount(o.group)
    z = np.abs(np.bincount(o.group, residual)) / np.sqrt(count)
    far = z > OUTLIER_SIGMAS * max(1.0, 1.4826 * float(np.median(z)))
    return np.unique(o.patch[far[o.group]])


def _step_statistics(
    o: Observations, solution: Solution, patches: int, strips: int, moved: int, membership: I64
) -> _Step:
    count = np.bincount(o.group)
    within = solution.residual - (np.bincount(o.group, solution.residual) / count)[o.group]
    inner = len(o.e) - len(count) - 2 * patches
    square = float(within @ within)
    before, after = (
        float(np.sqrt(np.average((np.bincount(o.group, r / o.scale) / count) ** 2, weights=count)))
        for r in (off_plane(o, o.e), solution.residual)
    )
    freedom = solution.freedom - inner
    noise2 = square / max(inner, 1)
    chi2 = (solution.chi2 - square) / noise2
    return _Step(
        solution,
        patches,
        strips,
        len(o.e),
        float(np.sqrt(noise2)),
        chi2,
        freedom,
        (before, after),
        moved,
        membership,
    )


def _result(
    p: _Problem, step: _Step, theta: F64, prior: F64, noise: float, before_m: float, number: int
) -> StripCalibration:
    posterior = np.zeros_like(prior)
    posterior[np.ix_(p.active, p.active)] = step.solution.C
    # what has no constant stays uncorrected, so its own spread is the prior's; with the corrected
    # ones it shares the posterior's covariance
    C_cal = posterior.copy()
    rest = np.setdiff1d(p.active, CORRECTED)
    C_cal[np.ix_(rest, rest)] = prior[np.ix_(rest, rest)]
    condition, weakest = _determinacy(prior, posterior, np.intersect1d(p.active, CORRECTED))
    found = StripCalibration(
        calibration_columns(p.beams),
        theta,
        prior,
        posterior,
        C_cal,
        condition,
        weakest,
        noise,
        step.chi2,
        step.freedom,
        before_m,
        step.offset_m[1],
        step.patches,
        step.strips,
        step.returns,
        step.moved_patches,
        number,
    )
    if all(found.status(k) in ("held at its prior", "fixed") for k in CORRECTED):
        raise CalibrationError(
            (
                "the strips tell no constant better than its prior: fly lanes in two "
                "directions, both ways, over ground with slopes"
            ),
            reason="calibration_unobservable",
            value=found.condition,
        )
    return found


def _determinacy(prior: F64, posterior: F64, constants: I64) -> tuple[float, F64]:
    """How well the constants (k,), columns of prior and posterior (c, c), are determined: the ratio
    of the best to the worst direction, sigma over prior sigma, and the worst one (c,) in units of
    the prior sigmas.
    """
    at = np.ix_(constants, constants)
    root = np.linalg.cholesky(prior[at])
    gain = np.linalg.solve(root, np.linalg.solve(root, posterior[at]).T)
    value, vector = np.linalg.eigh(0.5 * (gain + gain.T))
    weakest = np.zeros(len(prior))
    weakest[constants] = (root @ vector[:, -1]) / np.sqrt(np.diag(prior)[constants])
    return float(np.sqrt(value[-1] / max(value[0], 1e-300))), weakest

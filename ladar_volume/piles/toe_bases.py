"""Bases from the toe line of a pile: a level at its lowest, mean or highest height, the plane or
the quadratic through it, its own triangulation. Each follows the heights of the line linearly.

The lowest and the highest of many noisy heights are too low and too high. Both are taken from a
running mean along the line, what noise still does to them is told by drawing it again (parametric
bootstrap), and taken off; it stays in sigma.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ladar_volume.ground.polynomial import (
    design,
    design_surface,
    solve,
)
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.records import F64, Plane, Tin
from ladar_volume.piles.toe_line import PlacedSurface, ToeLine, toe_line
from ladar_volume.tin.full_tin import build_tin, footprint_areas
from ladar_volume.volume.polygon import areas_inside

#: Places in the running mean, and draws of the bootstrap.
WINDOW, DRAWS = 7, 400
#: The triangles of a toe line fill its outline to this part, after at most so many refinements.
FILLED, REFINED = 1e-9, 5
#: A triangle of less than this part of all area is a sliver.
FLAT = 1e-13
#: Degrees of the bases that are polynomials.
DEGREES = {"toe_plane": 1, "toe_quadratic": 2}


@dataclass(frozen=True)
class ToeBase:
    """plane : the base as a polynomial, or None · tin : its triangles where it is none · line : the
    toe line it is made from · by_heights : (p, t), derivatives of the polynomial's coefficients, or
    of the heights of the triangles' vertices, by the heights of the line · level_variance_m2 : of a
    level beyond what these derivatives carry
    """

    plane: Plane | None
    tin: Tin | None
    line: ToeLine
    by_heights: F64
    level_variance_m2: float = 0.0


def toe_base(
    name: str, surface: PlacedSurface, ring: F64, line: ToeLine, variance_m2: F64
) -> ToeBase:
    """The base called ``name`` (one of :data:`ladar_volume.model.piles.TOE_BASES`) of a pile within
    a ring (k, 2); variance_m2 : (n,) of the heights of the vertices, 0 where they are not known.
    Raises :class:`VolumeError` or GroundError where the toe line does not make it.
    """
    if name == "toe_tin":
        return triangulate_toe(surface, ring, line)
    if name in DEGREES:
        return polynomial(line, ring, DEGREES[name])
    if name == "toe_mean":
        M = (line.length_m / line.length_m.sum())[None]
        return ToeBase(design_surface((M @ line.height_m).tolist()), None, line, M)
    return extreme(line, variance_m2, 1.0 if name == "toe_highest" else -1.0)


def polynomial(line: ToeLine, ring: F64, degree: int) -> ToeBase:
    """Least squares through the toe line, every metre of it alike."""
    origin = ring.mean(axis=0)
    X, w = design(line.xy, origin, degree), np.sqrt(line.length_m)
    beta, N = solve(X * w[:, None], w * line.height_m, degree)
    plane = design_surface(beta.tolist(), (float(origin[0]), float(origin[1])))
    return ToeBase(plane, None, line, N @ (X * line.length_m[:, None]).T)


def triangulate_toe(surface: PlacedSurface, ring: F64, line: ToeLine) -> ToeBase:
    """The triangulation of the toe line within its outline. Raises :class:`VolumeError` (pile_toe)
    where none fills it.
    """
    step = float(np.diff(line.at_m).max())
    for _ in range(REFINED):
        made = build_tin(np.column_stack([line.xy, line.height_m]))
        own = footprint_areas(made.vertices, made.triangles)
        # slivers along straight sides have no area
        made = dataclasses.replace(made, relevant=own > FLAT * own.sum())
        inside = areas_inside(made, ring)
        kept = inside > 0.5 * own
        error = abs(float(own[kept].sum() - inside.sum())) + float(inside[~kept].sum())
        if error <= FILLED * float(inside.sum()):
            base = dataclasses.replace(made, relevant=kept)
            t = len(line.xy)
            M = np.zeros((len(made.vertices), t))
            M[np.arange(len(made.vertices)), made.source] = 1.0
            return ToeBase(None, base, line, M)
        step *= 0.5
        line = toe_line(surface, ring, step)
    raise VolumeError(
        "the toe line cannot be triangulated within its outline, whose sides come too near to one "
        "another: draw it with fewer corners",
        reason="pile_toe",
    )


def running_mean(line: ToeLine) -> F64:
    """Weights (t, t) of a mean over :data:`WINDOW` places along the closed line, by the lengths
    they stand for.
    """
    t, half = len(line.xy), WINDOW // 2
    near = (np.arange(t)[:, None] + np.arange(-half, half + 1)[None]) % t
    W = np.zeros((t, t))
    np.add.at(W, (np.arange(t)[:, None], near), line.length_m[near])
    total = W.sum(axis=1, keepdims=True)
    out: F64 = W / np.where(total > 0.0, total, 1.0)
    return out


def extreme(line: ToeLine, variance_m2: F64, sign: float) -> ToeBase:
    """The level of the highest (sign 1) or the lowest (−1) place."""
    W = running_mean(line)
    seen = W.sum(axis=1) > 0.0
    W = W[seen]
    height = W @ line.height_m
    at = int(np.argmax(sign * height))
    if not variance_m2.any():
        M = W[at][None]
        return ToeBase(design_surface([float(height[at])]), None, line, M)
    scaled = line.by_vertex.multiply(np.sqrt(variance_m2)[None]).tocsr()
    used = np.unique(scaled.indices)
    noise = np.random.default_rng(0).standard_normal((len(used), DRAWS))
    drawn = height[:, None] + W @ (scaled[:, used] @ noise)
    who = np.argmax(sign * drawn, axis=0)
    values = drawn[who, np.arange(DRAWS)]
    M = (np.bincount(who, minlength=len(W)) / DRAWS)[None] @ W
    bias = float(values.mean() - height[at])
    carried = M @ scaled[:, used].toarray()
    more = max(0.0, float(values.var()) - float((carried**2).sum())) + bias**2
    level = float(height[at]) - bias
    return ToeBase(design_surface([level]), None, line, M, more)

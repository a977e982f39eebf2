"""Least squares of one patch in its tangent frame: coordinates once per frame, refits to a fixed
point, the frame itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ladar_volume.math.array_types import F64, I64, Bool
from ladar_volume.math.kernels import kernel, leaf_kernel
from ladar_volume.math.normal_equations import basis, invert
from ladar_volume.rmls.thinning_weights import Thinning, balance, unthinned

#: Square of the slope from which the arc term no longer grows.
STEEPEST = 0.9
#: A fit has settled when its quadratic terms move the rim of the neighbourhood by less than this
#: share of sigma.
SETTLED = 1e-3


class RefitRule(NamedTuple):
    """ball : radius of the neighbourhood, m · sigmas, floor : threshold of an inlier in sigma, and
    its floor in m · iterations : most refits
    """

    ball: float
    sigmas: float
    floor: float
    iterations: int


class Terms(NamedTuple):
    """beta : (6,) of the surface in its frame, m · inverse : (6, 6) of the normal equations."""

    beta: F64
    inverse: F64


class Near(NamedTuple):
    """Points in a frame: uvw (3 or more, n), slots (n,) of each, and whether it is inside."""

    uvw: F64
    slots: I64
    inside: Bool


class Frame(NamedTuple):
    """centre : (3,) m · normal, tangent : (3,) unit vectors."""

    centre: F64
    normal: F64
    tangent: F64


class Residuals(NamedTuple):
    """straight : (n,) heights less the arc term · off : (n,) distances from the model, m."""

    straight: F64
    off: F64


@leaf_kernel
def tangent_of(normal: F64, tangent: F64) -> None:
    """A unit vector across the normal: along map x where that is not nearly the normal, else along
    map y.
    """
    axis = 0 if abs(normal[0]) < 0.9 else 1
    d = normal[axis]
    length = np.sqrt(1.0 - d * d)
    for k in range(3):
        tangent[k] = ((1.0 if k == axis else 0.0) - d * normal[k]) / length


@leaf_kernel
def second_tangent(normal: F64, tangent: F64, side: F64) -> None:
    """The second tangent vector, normal x tangent."""
    side[0] = normal[1] * tangent[2] - normal[2] * tangent[1]
    side[1] = normal[2] * tangent[0] - normal[0] * tangent[2]
    side[2] = normal[0] * tangent[1] - normal[1] * tangent[0]


@kernel
def move_to_surface(centre: F64, normal: F64, tangent: F64, beta: F64) -> None:
    """Move a frame's centre along its normal to a surface ``beta`` over it, and turn the normal to
    that of the surface there. The tangent stays.
    """
    side = np.empty(3)
    second_tangent(normal, tangent, side)
    length = np.sqrt(1.0 + beta[1] * beta[1] + beta[2] * beta[2])
    for k in range(3):
        centre[k] += beta[0] * normal[k]
        normal[k] = (normal[k] - beta[1] * tangent[k] - beta[2] * side[k]) / length


@leaf_kernel
def polynomial_row(r: F64, slot: int, centre: F64, tangent: F64, side: F64, p: int, x: F64) -> None:
    """``x[:p] = (1, u, v[, u², uv, v²])`` of one point in metres."""
    x0, x1, x2 = r[slot, 0] - centre[0], r[slot, 1] - centre[1], r[slot, 2] - centre[2]
    u = x0 * tangent[0] + x1 * tangent[1] + x2 * tangent[2]
    v = x0 * side[0] + x1 * side[1] + x2 * side[2]
    basis(u, v, p, x)


@leaf_kernel
def frame_coordinates(
    r: F64, n: int, centre: F64, normal: F64, tangent: F64, ball: float, uvw: F64, index: I64
) -> Any:
    """(u / ball, v / ball, w) of the points of r (n, 3) within ``ball`` of the centre, to uvw (3,
    m) and index (m,); returns m.
    """
    n0, n1, n2 = normal[0], normal[1], normal[2]
    t0, t1, t2 = tangent[0], tangent[1], tangent[2]
    s0, s1, s2 = n1 * t2 - n2 * t1, n2 * t0 - n0 * t2, n0 * t1 - n1 * t0
    m = 0
    for i in range(n):
        x, y, z = r[i, 0] - centre[0], r[i, 1] - centre[1], r[i, 2] - centre[2]
        u = x * t0 + y * t1 + z * t2
        v = x * s0 + y * s1 + z * s2
        w = x * n0 + y * n1 + z * n2
        if u * u + v * v + w * w <= ball * ball:
            uvw[0, m], uvw[1, m], uvw[2, m] = u / ball, v / ball, w
            index[m] = i
            m += 1
    return m


@leaf_kernel
def _rise(q: float, t: float) -> Any:
    """The height of :func:`arc_height` for a quadric's height q and the square t of its slope."""
    exact = q * (2.0 * (1.0 - np.sqrt(1.0 - t)) / t - 1.0)
    return 0.25 * q * t if t < 1e-6 else exact


@leaf_kernel
def arc_height(u: float, v: float, a: float, b: float, c: float) -> Any:
    """How far a surface of constant curvature lies above its osculating quadric ``q = a u² + b uv +
    c v²``, and the slopes along u and v of both together.

    With g = grad q the height ``q · 2 (1 − √(1 − g²)) / g²`` is exact for a sphere and for a
    cylinder in any direction. A bare quadric over a wide neighbourhood of a curved surface is
    biased at its centre by its missing fourth-order term. Steeper than the limit the correction
    stays what it is there.
    """
    q = a * u * u + b * u * v + c * v * v
    gu, gv = 2.0 * a * u + b * v, b * u + 2.0 * c * v
    square = gu * gu + gv * gv
    t = min(square, STEEPEST)
    if t < 1e-6:
        return _rise(q, t), gu, gv
    s = np.sqrt(1.0 - t)
    factor = 2.0 * (1.0 - s) / t
    # d factor / dt times dt: zero where the limit holds
    rate = q * (1.0 / s - factor) / t if square < STEEPEST else 0.0
    tu, tv = 2.0 * (2.0 * a * gu + b * gv), 2.0 * (b * gu + 2.0 * c * gv)
    return _rise(q, t), gu * factor + rate * tu, gv * factor + rate * tv


@leaf_kernel
def _straighten(uvw: F64, m: int, b: F64, ball: float, straight: F64) -> None:
    """Heights less the arc term of the present coefficients, to ``straight``: what is left is
    linear in the coefficients.
    """
    k3, k4, k5 = b[3] / (ball * ball), b[4] / (ball * ball), b[5] / (ball * ball)
    for i in range(m):  # no branch: several points at once
        u, v = uvw[0, i] * ball, uvw[1, i] * ball
        gu, gv = 2.0 * k3 * u + k4 * v, k4 * u + 2.0 * k5 * v
        straight[i] = uvw[2, i] - _rise(
            k3 * u * u + k4 * u * v + k5 * v * v, min(gu * gu + gv * gv, STEEPEST)
        )


@leaf_kernel
def normal_plane(near: Near, m: int, weight: F64, A: F64, b: F64) -> None:
    """Normal equations of a plane over the m points inside, with weights (m,): ``XᵀWX`` to A (3, 3)
    from its diagonal down, ``XᵀWw`` to b (3,).
    """
    a00 = a10 = a20 = a11 = a21 = a22 = b0 = b1 = b2 = 0.0
    uvw, inside = near.uvw, near.inside
    for i in range(m):
        if inside[i]:
            u, v, w, g = uvw[0, i], uvw[1, i], uvw[2, i], weight[i]
            gu, gv = g * u, g * v
            a00 += g
            a10 += gu
            a20 += gv
            a11 += gu * u
            a21 += gv * u
            a22 += gv * v
            b0 += g * w
            b1 += gu * w
            b2 += gv * w
    A[0, 0], A[1, 0], A[2, 0], A[1, 1], A[2, 1], A[2, 2] = a00, a10, a20, a11, a21, a22
    b[0], b[1], b[2] = b0, b1, b2


@leaf_kernel
def normal_quadric(near: Near, straight: F64, m: int, weight: F64, A: F64, b: F64) -> None:
    """As :func:`normal_plane`, of a quadric to heights ``straight`` (m,): A (6, 6), b (6,)."""
    # one sum per monomial u^i v^j up to the fourth degree: the 21 entries of the matrix are only 15
    # different sums
    c, u1, v1, u2, uv, v2, u3, u2v, uv2, v3 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u4 = u3v = u2v2 = uv3 = v4 = b0 = b1 = b2 = b3 = b4 = b5 = 0.0
    uvw, inside = near.uvw, near.inside
    for i in range(m):
        if inside[i]:
            u, v, w, g = uvw[0, i], uvw[1, i], straight[i], weight[i]
            gu, gv = g * u, g * v
            uu, q, vv = gu * u, gu * v, gv * v
            c += g
            u1 += gu
            v1 += gv
            u2 += uu
            uv += q
            v2 += vv
            u3 += uu * u
            u2v += uu * v
            uv2 += u * vv
            v3 += vv * v
            u4 += uu * (u * u)
            u3v += uu * (u * v)
            u2v2 += uu * (v * v)
            uv3 += q * (v * v)
            v4 += vv * (v * v)
            b0 += g * w
            b1 += gu * w
            b2 += gv * w
            b3 += uu * w
            b4 += q * w
            b5 += vv * w
    A[0, 0], A[1, 0], A[2, 0], A[3, 0], A[4, 0], A[5, 0] = c, u1, v1, u2, uv, v2
    A[1, 1], A[2, 1], A[3, 1], A[4, 1], A[5, 1] = u2, uv, u3, u2v, uv2
    A[2, 2], A[3, 2], A[4, 2], A[5, 2] = v2, u2v, uv2, v3
    A[3, 3], A[4, 3], A[5, 3], A[4, 4], A[5, 4], A[5, 5] = u4, u3v, u2v2, u2v2, uv3, v4
    b[0], b[1], b[2], b[3], b[4], b[5] = b0, b1, b2, b3, b4, b5


@leaf_kernel
def _off_quadric(
    uvw: F64, residuals: Residuals, m: int, b: F64, ball: float, threshold: float
) -> None:
    """Residuals along the quadric's own normal, infinite beyond its neighbourhood: that is a ball
    about the *foot points*. A ball about the noisy points keeps more of those on the hollow side,
    which pulls a curved surface inwards.
    """
    straight, off = residuals.straight, residuals.off
    reach = max(1.0 - threshold / ball, 0.5)
    b0, b1, b2, b3, b4, b5 = b[0], b[1], b[2], b[3], b[4], b[5]
    for i in range(m):  # no branch and no sum: several points at once
        u, v = uvw[0, i], uvw[1, i]
        d = straight[i] - b0 - u * b1 - v * b2 - u * u * b3 - u * v * b4 - v * v * b5
        gu, gv = (b1 + 2.0 * u * b3 + v * b4) / ball, (b2 + u * b4 + 2.0 * v * b5) / ball
        slope = 1.0 + gu * gu + gv * gv
        fu, fv, fw = (
            u + d * gu / (slope * ball),
            v + d * gv / (slope * ball),
            (uvw[2, i] - d / slope) / ball,
        )
        d = abs(d / np.sqrt(slope))
        off[i] = d if fu * fu + fv * fv + fw * fw <= reach * reach else np.inf


@leaf_kernel
def _off_plane(uvw: F64, m: int, b: F64, off: F64) -> None:
    """Residuals along the frame's normal."""
    b0, b1, b2 = b[0], b[1], b[2]
    for i in range(m):
        off[i] = abs(uvw[2, i] - b0 - uvw[0, i] * b1 - uvw[1, i] * b2)


@leaf_kernel
def distances(
    uvw: F64, residuals: Residuals, m: int, p: int, b: F64, ball: float, threshold: float
) -> None:
    """Residuals of the m points uvw from the terms b (p,) of a quadric, p = 6, or a plane, to
    ``residuals.off``, in metres; what lies beyond the quadric's ball is infinitely far.
    """
    if p == 6:
        _off_quadric(uvw, residuals, m, b, ball, threshold)
    else:
        _off_plane(uvw, m, b, residuals.off)


@leaf_kernel
def classify(off: F64, m: int, threshold: float, inside: Bool) -> tuple[int, bool]:
    """Mark the points within ``threshold`` of the model; returns (how many, any change)."""
    used, changed = 0, False
    for i in range(m):
        near = off[i] <= threshold
        used += near
        changed |= near != inside[i]
        inside[i] = near
    return used, changed


@leaf_kernel
def weighted_square(off: F64, m: int, inside: Bool, weight: F64) -> float:
    """Weighted sum of the squared residuals of the points marked inside."""
    square = 0.0
    for i in range(m):
        if inside[i]:
            square += weight[i] * (off[i] * off[i])
    return square


@kernel
def _solve(p: int, A: F64, right: F64, inverse: F64, b: F64) -> float:
    """Coefficients of the normal equations, whose upper half is filled in, to b; returns how far
    the quadratic ones moved, −1 where the terms are not determined.
    """
    for k in range(p):
        for l in range(k):
            A[l, k] = A[k, l]
    if not invert(A, p, inverse):
        return -1.0
    shift = 0.0
    for k in range(p):
        new = 0.0
        for l in range(p):
            new += inverse[k, l] * right[l]
        # only the arc term, which follows the quadratic terms, can still move when the inliers
        # have settled
        shift = max(shift, abs(new - b[k]) if k > 2 else 0.0)
        b[k] = new
    return shift


@leaf_kernel
def _to_metres(p: int, b: F64, ball: float, terms: Terms) -> None:
    """Terms over (u, v) / ball as terms over (u, v)."""
    beta, inverse = terms.beta, terms.inverse
    for k in range(p):
        unit_k = 1.0 if k == 0 else 1.0 / ball if k < 3 else 1.0 / (ball * ball)
        beta[k] = b[k] * unit_k
        for l in range(p):
            unit_l = 1.0 if l == 0 else 1.0 / ball if l < 3 else 1.0 / (ball * ball)
            inverse[k, l] *= unit_k * unit_l


@kernel
def refit(
    near: Near, m: int, p: int, sigma: float, rule: RefitRule, thinning: Thinning, terms: Terms
) -> tuple[int, float]:
    """Least squares on the inliers, weighted by what each stands for, iterated until they stay the
    same. ``near.inside`` (m,) holds the start.

    u and v are scaled by the ball's radius inside, so the pivots mean the same at every scale;
    ``beta`` and ``inverse`` = (XᵀWX)⁻¹ come back in metres. Returns (number of inliers, sigma); 0
    inliers where the terms are not determined.
    """
    ball, A, b, right = rule.ball, np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    inside, weight = near.inside, thinning.weight
    residuals = Residuals(np.empty(m), np.empty(m))
    straight, used, shift = residuals.straight, 0, 0.0
    balance(thinning, m, inside)
    for step in range(rule.iterations + 1):
        if step > 0:
            # noise-free input: from the second step on above the rounding of coordinates
            rounding = 1e-7 * ball if step > 1 else 0.0
            threshold = max(rule.sigmas * sigma, rule.floor, rounding)
            distances(near.uvw, residuals, m, p, b, ball, threshold)
            used, changed = classify(residuals.off, m, threshold, inside)
            if used <= p:
                return 0, sigma
            balance(thinning, m, inside)
            sigma = np.sqrt(weighted_square(residuals.off, m, inside, weight) / (used - p))
            if step > 1 and not changed and shift <= SETTLED * sigma:
                break
        if p == 6:
            _straighten(near.uvw, m, b, ball, straight)
            normal_quadric(near, straight, m, weight, A, right)
        else:
            normal_plane(near, m, weight, A, right)
        shift = _solve(p, A, right, terms.inverse, b)
        if shift < 0.0:
            return 0, sigma
    _to_metres(p, b, ball, terms)
    return used, sigma


@leaf_kernel
def mark_flat(uvw: F64, m: int, threshold: float, inside: Bool) -> None:
    """Mark the points within ``threshold`` of the tangent plane."""
    for i in range(m):
        inside[i] = abs(uvw[2, i]) <= threshold


@kernel
def lay_on_plane(origin: F64, beta: F64, frame: Frame) -> None:
    """Turn a frame into the plane beta over it, and move it to the foot point of ``origin``."""
    centre, normal, tangent, new = frame.centre, frame.normal, frame.tangent, np.empty(3)
    t0, t1, t2 = tangent[0], tangent[1], tangent[2]
    new[0] = normal[0] - beta[1] * t0 - beta[2] * (normal[1] * t2 - normal[2] * t1)
    new[1] = normal[1] - beta[1] * t1 - beta[2] * (normal[2] * t0 - normal[0] * t2)
    new[2] = normal[2] - beta[1] * t2 - beta[2] * (normal[0] * t1 - normal[1] * t0)
    length = np.sqrt(new[0] * new[0] + new[1] * new[1] + new[2] * new[2])
    h = 0.0
    for k in range(3):
        new[k] /= length
        # the plane passes through centre + beta0 normal; the foot point of origin on it is the
        # new centre
        h += (origin[k] - centre[k] - beta[0] * normal[k]) * new[k]
    for k in range(3):
        centre[k] = origin[k] - h * new[k]
        normal[k] = new[k]


@kernel
def level_frame(
    r: F64,
    n: int,
    origin: F64,
    plane: F64,
    sigma: float,
    rule: RefitRule,
    near: Near,
    frame: Frame,
) -> float:
    """Turn a start plane into a frame at the foot point of ``origin``: a plane refit and re-tilt
    until it lies flat.

    Returns the plane's sigma, −1 where no plane is determined.
    """
    ball, uvw, inside = rule.ball, near.uvw, near.inside
    centre, normal, tangent = frame.centre, frame.normal, frame.tangent
    terms = Terms(np.zeros(6), np.zeros((6, 6)))
    beta = terms.beta
    normal[:] = plane[:3]
    height = origin[0] * normal[0] + origin[1] * normal[1] + origin[2] * normal[2] - plane[3]
    for k in range(3):
        centre[k] = origin[k] - height * normal[k]
    for _ in range(3):
        tangent_of(normal, tangent)
        m = frame_coordinates(r, n, centre, normal, tangent, ball, uvw, near.slots)
        mark_flat(uvw, m, max(rule.sigmas * sigma, rule.floor, 0.5e-7 * ball), inside)
        used, sigma = refit(near, m, 3, sigma, rule, unthinned(m), terms)
        if used == 0:
            return -1.0
        lay_on_plane(origin, beta, frame)
        if abs(beta[1]) + abs(beta[2]) < 1e-6:
            break
    tangent_of(normal, tangent)
    return sigma

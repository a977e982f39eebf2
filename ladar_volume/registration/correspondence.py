"""The transform between two sets of numbered spheres whose numbers may be wrong.

The numbers are believed where the spheres then agree and nothing else fits as well. Else the
distances between the centres tell the numbering, if one alone fits; where none does, it is said
what the matter is: units, a mirrored frame, or spheres that moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ladar_volume.model.errors import RegistrationError
from ladar_volume.model.records import F64, I64
from ladar_volume.registration.sphere_adjustment import Registration, register
from ladar_volume.registration.sphere_matching import Numbering, extent, numberings

#: Spheres that disagree by more than so many times their noise are refused; below, the covariance
#: is scaled by what they disagree by.
GROSS_SIGMA0 = 5.0
#: Centres whose least extent is below this share of the largest do not tell a mirrored frame.
FLAT_SHARE = 1e-3
#: Scales that are named, B over A.
UNITS = {
    1000.0: "A is in metres and B in millimetres",
    0.001: "A is in millimetres and B in metres",
    1.0 / 0.3048: "A is in metres and B in feet",
    0.3048: "A is in feet and B in metres",
    100.0: "A is in metres and B in centimetres",
    0.01: "A is in centimetres and B in metres",
}


@dataclass(frozen=True)
class Centres:
    """Spheres of one frame. number : (n,) int64, each once · r : (n, 3) m · C : (n, 3, 3) m²"""

    number: I64
    r: F64
    C: F64

    def sigma(self) -> float:
        """A typical standard deviation of a coordinate, m."""
        if not len(self.C):
            return 0.0
        return float(np.sqrt(np.median(np.trace(self.C, axis1=1, axis2=2)) / 3.0))


@dataclass(frozen=True)
class Correspondence:
    """registration : of the spheres in these rows · rows_a, rows_b : (k,) of both sets · renumbered
    : whether the distances and not the numbers told · others : how many other numberings lay as
    many spheres on one another
    """

    registration: Registration
    rows_a: I64
    rows_b: I64
    renumbered: bool
    others: int


def by_number(a: Centres, b: Centres) -> Numbering:
    """The numbering as given."""
    at = {int(k): j for j, k in enumerate(b.number)}
    partner = np.array([at.get(int(k), -1) for k in a.number], np.int64)
    return Numbering(partner, 1.0)


def register_numbering(
    a: Centres, b: Centres, one: Numbering, levelled: bool, scale: float | None
) -> Registration:
    """The registration of a numbering. Raises :class:`RegistrationError` as
    :func:`~ladar_volume.registration.sphere_adjustment.register` does.
    """
    i = np.flatnonzero(one.partner >= 0)
    j = one.partner[i]
    if not len(i):
        raise RegistrationError(
            "no sphere has the same number in both files", reason="registration_too_few", value=0
        )
    return register(a.r[i], b.r[j], a.C[i], b.C[j], levelled=levelled, scale=scale)


def correspond(
    a: Centres, b: Centres, *, levelled: bool = False, scale: float | None = 1.0
) -> Correspondence:
    """Register two sets of spheres by their numbers, or by the distances between their centres.

    Raises :class:`RegistrationError` as ``register`` does, and: registration_numbers (several
    numberings fit, and not the given one), registration_units, registration_mirrored,
    registration_disagree.
    """
    given, error = by_number(a, b), None
    try:
        first: Registration | None = register_numbering(a, b, given, levelled, scale)
    except RegistrationError as caught:
        if caught.reason in ("registration_collinear", "registration_vertical"):
            raise
        first, error = None, caught
    sound = first is not None and first.consistent
    kept = int(first.used.sum()) if first is not None and sound else 0
    fitting = agreeing_numberings(a, b, levelled, scale)
    most = max((int(f.used.sum()) for _, f in fitting), default=0)
    best = [(one, f) for one, f in fitting if int(f.used.sum()) == most]
    if max(kept, most) < min(len(a.r), len(b.r)):
        check_scale_and_mirror(a, b, levelled, scale, max(kept, most))
    if first is not None and sound and kept >= most:
        others = sum(not pairs_as_given(one, given, first) for one, _ in best if kept == most)
        return as_rows(first, given, False, others)
    if most > 0 and 2 * most > min(len(a.r), len(b.r)):
        if len(best) == 1:
            return as_rows(best[0][1], best[0][0], True, 0)
        raise RegistrationError(
            f"the numbers of the spheres do not agree, and {len(best)} numberings lay "
            f"{most} of them on one another: number them right, or add a sphere off the symmetry",
            reason="registration_numbers",
            value=len(best),
        )
    return keep_numbering(a, b, given, first, error)


def keep_numbering(
    a: Centres,
    b: Centres,
    given: Numbering,
    first: Registration | None,
    error: RegistrationError | None,
) -> Correspondence:
    """The numbering as given where no other is better, with the covariance that its disagreement
    shows. Raises :class:`RegistrationError`: its own, or registration_disagree.
    """
    if first is None and (error is None or error.reason != "registration_too_few"):
        assert error is not None
        raise error
    if first is None or not first.sigma0 <= GROSS_SIGMA0:
        if error is not None:
            raise error
        raise no_numbering_error(a, b, given)
    T = first.transform
    wide = replace(first, transform=replace(T, C=T.C * max(first.sigma0, 1.0) ** 2))
    return as_rows(wide, given, False, 0)


def agreeing_numberings(
    a: Centres, b: Centres, levelled: bool, scale: float | None
) -> list[tuple[Numbering, Registration]]:
    """The numberings that lay most spheres on one another and agree within the noise."""
    sigma = float(np.hypot(a.sigma(), b.sigma()))
    found = numberings(a.r, b.r, sigma, levelled=levelled, scale=scale)
    out = []
    for one in found:
        if len(one) < len(found[0]):
            break
        try:
            f = register_numbering(a, b, one, levelled, scale)
        except RegistrationError:
            continue
        if f.consistent:
            out.append((one, f))
    return out


def pairs_as_given(one: Numbering, given: Numbering, first: Registration) -> bool:
    """Whether a numbering pairs the spheres that ``first`` used as given."""
    i = np.flatnonzero(given.partner >= 0)[first.used]
    return bool((one.partner[i] == given.partner[i]).all())


def as_rows(found: Registration, one: Numbering, renumbered: bool, others: int) -> Correspondence:
    """The rows of a numbering."""
    i = np.flatnonzero(one.partner >= 0)
    return Correspondence(found, i, one.partner[i], renumbered, others)


def check_scale_and_mirror(
    a: Centres, b: Centres, levelled: bool, scale: float | None, kept: int
) -> None:
    """Raises :class:`RegistrationError` where another scale (registration_units) or a mirrored
    frame (registration_mirrored) makes more spheres agree than the ``kept`` that do without; four
    spheres at least tell.
    """
    wanted = max(4, kept + 1, min(len(a.r), len(b.r)) // 2 + 1)
    if min(len(a.r), len(b.r)) < wanted:
        return
    sigma = float(np.hypot(a.sigma(), b.sigma()))
    for one in numberings(a.r, b.r, sigma, levelled=levelled, scale=None)[:1]:
        if scale is not None and len(one) >= wanted and abs(one.scale / scale - 1.0) > 1e-3:
            raise unit_error(one.scale / scale)
    d = a.r - a.r.mean(axis=0)
    thick = np.linalg.svd(d[:, :2] if levelled else d, compute_uv=False)
    if thick[-1] <= max(10.0 * a.sigma() * np.sqrt(len(d)), FLAT_SHARE * thick[0]):
        return  # what lies in a plane is its own mirror image
    flip = np.array([1.0, -1.0, 1.0])
    for one in numberings(a.r * flip, b.r, sigma, levelled=levelled, scale=scale)[:1]:
        if len(one) >= wanted:
            raise RegistrationError(
                f"{len(one)} spheres agree only where one frame is mirrored: two axes of a file "
                "are swapped, or one has the wrong sign",
                reason="registration_mirrored",
                value=len(one),
            )


def unit_error(ratio: float) -> RegistrationError:
    """The error that names the units of two frames whose distances differ by a factor."""
    named = [words for factor, words in UNITS.items() if abs(ratio / factor - 1.0) < 0.01]
    what = f"it seems that {named[0]}: bring both into metres" if named else "check the units of "
    return RegistrationError(
        f"the distances between the spheres are {ratio:.6g} times as long in B as in A; "
        + (what if named else what + "both files, or use --free-scale"),
        reason="registration_units",
        value=ratio,
    )


def no_numbering_error(a: Centres, b: Centres, given: Numbering) -> RegistrationError:
    """The error of spheres that agree in no numbering, with the distance that differs most."""
    i = np.flatnonzero(given.partner >= 0)
    x, y = a.r[i], b.r[given.partner[i]]
    apart = [np.linalg.norm(r[:, None] - r[None], axis=2) for r in (x, y)]
    off = np.abs(apart[1] - apart[0])
    j, k = np.unravel_index(int(off.argmax()), off.shape)
    one, two = int(a.number[i[j]]), int(a.number[i[k]])
    return RegistrationError(
        f"the spheres do not agree in any numbering: between {one} and {two} it is "
        f"{apart[0][j, k]:.3f} m in A and {apart[1][j, k]:.3f} m in B (extent {extent(x):.1f} m); "
        "did one move? Measure them again, with at least four",
        reason="registration_disagree",
        value=float(off.max()),
    )

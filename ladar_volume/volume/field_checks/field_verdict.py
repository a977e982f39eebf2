"""A volume as it comes from the budget, with what the field adds to it: lines of the budget and
doubts.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ladar_volume.ground.heights import height_above
from ladar_volume.model.choices import CALIBRATION_GROUPS, SOURCE_LINES
from ladar_volume.model.errors import VolumeError
from ladar_volume.model.parameters import Parameters, SurfaceFilterParameters
from ladar_volume.model.records import F64, Agreement, Bool, StandingObject, Tin, Volume
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.tin.full_tin import vertex_mask
from ladar_volume.uncertainty.ground_field import Roughness
from ladar_volume.uncertainty.pass_agreement import (
    MOST,
    OF_SLOPES,
    REFUTED,
    Scatter,
    cover_scatter,
    own_scatter,
    pass_agreement,
    patch_scatter,
    plain_patches,
)
from ladar_volume.volume.base import polygon_of
from ladar_volume.volume.chord_bias import cut_and_fill_chords
from ladar_volume.volume.cutfill import with_net
from ladar_volume.volume.field_checks.base_readings import (
    GroundSeen,
    base_reading_doubts,
    below_base,
    doubted_m6,
    given_base_doubts,
    ground_seen,
    readings_on,
    student_factor,
    unsettled,
)
from ladar_volume.volume.field_checks.completeness import Surroundings, steep, surroundings_of
from ladar_volume.volume.field_checks.cut_bodies import cut_m6
from ladar_volume.volume.field_checks.findings import Ask
from ladar_volume.volume.field_checks.gap_kriging import ObservedPoints
from ladar_volume.volume.field_checks.gaps import (
    bridged_volume,
    bridging_triangles,
    find_gaps,
    gap_doubts,
    hidden_m6,
    seen_above,
)
from ladar_volume.volume.field_checks.notches import notch_doubts
from ladar_volume.volume.field_checks.null_volumes import null_volume_doubts, null_volumes
from ladar_volume.volume.field_checks.plant_cover import (
    bush_doubts,
    bush_volume,
    cover_sigma,
    known_cover,
)
from ladar_volume.volume.field_checks.sight_lines import patch_views
from ladar_volume.volume.field_checks.standing_objects import object_doubts
from ladar_volume.volume.field_checks.steep_faces import (
    NEGLIGIBLE,
    edge_doubts,
    enclosed_m6,
    steep_faces,
    wall_m6,
)
from ladar_volume.volume.field_checks.surface_changes import (
    SurfaceChange,
    change_doubt,
    surface_change,
)
from ladar_volume.volume.measured_body import (
    BodySurface,
    Footing,
    SurveyedSurface,
    footing_of,
)

#: Lines of the budget that returns do not share.
OWN = ("noise", "noise_tangential", "smoothing", "base_surface")
#: Share of the points that a median screen may change: more are no outliers.
MOST_SCREENED = 0.05
#: A change of the surface matters from so many standard deviations of the volume on.
CHANGED = 0.5
#: Errors so many times as large as stated scatter returns of slopes as plants do. Attitudes five
#: times worse scattered none where they were told as less than this.
SCATTERS = 3.0
#: Rounds until no gap is left to be bridged: a bridge may join parts of a body.
ROUNDS = 3


@dataclass(frozen=True)
class SurveyInField:
    """What all bodies of a survey share: its surface, what they stand on, its passes, and what
    checks found once for all.
    """

    survey: SurveyedSurface
    footing: Footing
    passes: PassAgreement
    parameters: Parameters

    @cached_property
    def surroundings(self) -> Surroundings:
        """What lies along the outline of all bodies."""
        tin, base, inside = self.survey.tin, self.footing.base, self.footing.inside
        return surroundings_of(tin, base, inside, self.on_face, self.parameters)

    @cached_property
    def ground(self) -> GroundSeen | None:
        """What other readings of the base are held against."""
        return ground_seen(self.survey.tin, self.footing.base, self.survey.height_variance)

    @cached_property
    def on_face(self) -> Bool:
        """Vertices (n,) on steep faces."""
        return steep(self.survey.normal)

    @cached_property
    def seen(self) -> ObservedPoints:
        """What was seen, above the base."""
        survey, tin = self.survey, self.survey.tin
        view = patch_views(survey.patches)[survey.sources.geometry.row[tin.source]]
        return seen_above(tin, self.footing.base, survey.height_variance, view)


class BodyInField(NamedTuple):
    """on : its surface · rough : the field of the ground about its base, None above a base that is
    given · objects : that were taken out of its surface
    """

    on: BodySurface
    rough: Roughness | None
    objects: tuple[StandingObject, ...] = ()


def bridged_footing(
    survey: SurveyedSurface, footing: Footing, parameters: Parameters
) -> tuple[SurveyedSurface, Footing]:
    """The surface with the gaps inside the outline bridged, and the footing of that."""
    polygon = polygon_of(parameters.volume) if parameters.volume.outline == "polygon" else None
    for _ in range(ROUNDS):
        more = bridging_triangles(
            survey.tin, footing.base, footing.inside, polygon, parameters.volume
        )
        if not more.any():
            break
        tin = dataclasses.replace(survey.tin, relevant=survey.tin.relevant | more)
        surface = dataclasses.replace(survey.surface, tin=tin)
        survey = dataclasses.replace(survey, surface=surface)
        footing = footing_of(survey, parameters)
    return survey, footing


def with_line(volume: Volume, name: str, variance_m6: float) -> Volume:
    """The volume with a line of the budget more, or one that is so much larger."""
    if not variance_m6 > 0.0:
        return volume
    low, high = (math.hypot(s, math.sqrt(variance_m6)) for s in volume.sigma_tau_range_m3)
    return dataclasses.replace(
        volume,
        sigma_m3=math.hypot(volume.sigma_m3, math.sqrt(variance_m6)),
        budget_m6={
            **volume.budget_m6,
            name: volume.budget_m6.get(name, 0.0) + variance_m6,
        },
        sigma_tau_range_m3=(low, high),
    )


def with_gaps(field: SurveyInField, on: BodySurface, volume: Volume) -> Volume:
    """The volume of a body with what was not seen of it."""
    survey, part, base = on.survey, on.part, field.footing.base
    tin = survey.tin
    gaps = find_gaps(tin, part)
    volume = with_line(volume, "unseen", hidden_m6(tin, base, part, gaps, survey.hidden))
    if not len(gaps.areas):
        return volume
    over = np.where(gaps.triangle >= 0, part, 0.0)
    # slopes at the rim of a gap tell of its surface by kriging, not as chords
    above, below = cut_and_fill_chords(tin, survey.normal, base, over)
    found = bridged_volume(tin, base, part, gaps, lambda: field.seen)
    cut, fill = with_net(volume.cut_m3 + above, volume.fill_m3 - below, found.more_m3)
    doubts = gap_doubts(found, gaps.area_m2, volume.area_m2, volume.volume_m3, volume.sigma_m3)
    volume = dataclasses.replace(
        volume,
        volume_m3=volume.volume_m3 + above + below + found.more_m3,
        cut_m3=cut,
        fill_m3=fill,
        chord_m3=volume.chord_m3 - above - below,
        seen_share=1.0 - gaps.area_m2 / max(float(part.sum()), 1e-300),
        gaps=found.gaps,
        verdict=volume.verdict + Verdict(tuple(doubts)),
    )
    return with_line(volume, "unseen", found.variance_m6)


def with_null_volumes(
    survey: SurveyedSurface, footing: Footing, body: BodyInField, volume: Volume, ask: Ask
) -> Volume:
    """The volume of a body with the line of its base as wide as null volumes around it spread."""
    own = volume.budget_m6.get("base_surface", 0.0)
    rough = body.rough
    if rough is None or not own > 0.0:
        return volume
    tin, base, part, noise = survey.tin, footing.base, body.on.whole, survey.height_variance
    found = ask("null volumes", lambda: null_volumes(tin, base, part, noise, rough))
    doubts = Verdict(tuple(null_volume_doubts(found, volume.area_m2, math.sqrt(own))))
    volume = dataclasses.replace(volume, verdict=volume.verdict + doubts)
    return with_line(volume, "base_surface", (found.scale - 1.0) * own)


def with_base(field: SurveyInField, body: BodyInField, volume: Volume, ask: Ask) -> Volume:
    """The volume of a body with what null volumes and other readings of its base say."""
    survey, base, parameters = field.survey, field.footing.base, field.parameters
    around, part, radius_m = body.on.survey, body.on.part, parameters.filter.radius_m
    volume = with_null_volumes(survey, field.footing, body, volume, ask)
    if not len(base.support):
        free, before = parameters.volume.outline == "auto", volume
        told = ask(
            "given base",
            lambda: given_base_doubts(around.tin, base, part, radius_m, before, free),
        )
        volume = dataclasses.replace(volume, verdict=volume.verdict + Verdict(tuple(told)))
        apart = sum((d.value or 0.0) * volume.area_m2 for d in told)
        return with_line(volume, "base_model", apart**2)
    noise = around.height_variance
    found = ask(
        "base readings",
        lambda: readings_on(field.ground, around.tin, base, part, noise, radius_m),
    )
    if found is None:
        return volume
    told = base_reading_doubts(found, volume.volume_m3, volume.sigma_m3, volume.base)
    told += unsettled(base, volume.sigma_m3)
    if volume.cut_m3 > volume.fill_m3:  # a pit has a rim
        told += below_base(volume.cut_m3, volume.fill_m3, volume.sigma_m3)
    doubts = Verdict(tuple(told))
    share = volume.budget_m6.get("base_surface", 0.0) / max(volume.sigma_m3**2, 1e-300)
    factor = student_factor(volume.coverage_factor, volume.confidence, share, found.freedom)
    volume = dataclasses.replace(volume, coverage_factor=factor, verdict=volume.verdict + doubts)
    return with_line(volume, "base_model", found.variance_m6 + doubted_m6(told))


def budget_scales(found: Agreement | None, check: str, lines: Iterable[str]) -> dict[str, float]:
    """By how much each of the budget's lines is made larger: 1 where the passes do not refute the
    budget, or are not to scale it. Where they refute groups of sources, the lines of these are;
    else all that returns share.
    """
    if found is None or check != "scale":
        return dict.fromkeys(lines, 1.0)
    by_line = {
        line: max(s.scale, 1.0) ** power
        for s in found.sources
        for line, power in SOURCE_LINES[s.name].items()
    }
    groups = any(s.scale > 1.0 for s in found.sources if s.name != "noise")
    by_line["calibration"] = max(by_line.get(name, 1.0) for name in CALIBRATION_GROUPS)
    alone = 1.0 if groups or not found.refuted else max(1.0, min(found.factor, MOST))
    return {name: by_line.get(name, 1.0) if groups or name in OWN else alone for name in lines}


def variance_ratio(volume: Volume, found: Agreement | None, check: str) -> float:
    """Variance of a volume with its lines as the passes have them over that by the budget."""
    lines = volume.budget_m6
    scales = budget_scales(found, check, lines)
    before = sum(lines.values())
    return sum(scales[k] * v for k, v in lines.items()) / before if before > 0.0 else 1.0


def shift_words(found: Agreement) -> str:
    """How passes lie apart sideways, and what to do."""
    return (
        f"passes lie some {1e2 * found.shift_m:.2g} cm apart along the direction "
        f"{found.shift_deg:.0f}° (counter-clockwise from east), seen on the slopes: look for a "
        "jump of the fixes or a wrong datum in a part of the flight, or leave that part out"
    )


def group_words(found: Agreement) -> str:
    """By how much one group of sources alone would have to be worse."""
    alone = [s for s in found.sources if s.visible and s.p_value < REFUTED]
    if not alone:
        return ""
    listed = ", ".join(
        f"{s.name.replace('_', ' ')} {math.sqrt(s.factor):.2g} times"
        for s in sorted(alone, key=lambda s: s.factor)
    )
    return f" (were one alone to blame: {listed} its sigma)"


def with_passes(volume: Volume, found: Agreement | None, check: str) -> Volume:
    """The volume with what the agreement of the passes says of its budget. Raises
    :class:`VolumeError` where a refuted budget is to be refused.
    """
    volume = dataclasses.replace(volume, agreement=found)
    if found is not None and found.shift_m > 0.0:
        shifted = Verdict((Doubt("passes_shifted", shift_words(found), found.shift_m),))
        volume = dataclasses.replace(volume, verdict=volume.verdict + shifted)
    if found is None:
        return volume
    scales = budget_scales(found, check, {**volume.budget_m6, **volume.budget_within_m6})
    if not found.refuted:
        return scaled_lines(volume, scales)
    words = refuted_words(found)
    if scatters_slopes(found):
        words += "; such errors may hide plants on the ground or on the body"
    if check == "refuse":
        raise VolumeError(words, reason="volume_budget_refuted", value=found.factor)
    doubt = Doubt("budget", words, found.factor)
    volume = dataclasses.replace(volume, verdict=volume.verdict + Verdict((doubt,)))
    return scaled_lines(volume, scales)


def refuted_words(found: Agreement) -> str:
    """By how much passes and beams disagree, and what to do."""
    scaled = [s for s in found.sources if s.scale > 1.0 and s.name != "noise"]
    if scaled:
        listed = ", ".join(
            f"{s.name.replace('_', ' ')} {math.sqrt(s.factor):.2g} ± "
            f"{0.5 * s.sigma / math.sqrt(s.factor):.1g} times its sigma (p = {s.p_value:.1g})"
            for s in sorted(scaled, key=lambda s: -s.factor)
        )
        return (
            f"passes and beams lie over each other as with {listed}: run `calibrate strips`, look "
            "for a jump of the fixes or a wrong clock, or give a true budget"
        )
    return (
        f"passes lie apart: the median patch scatters by {1e3 * found.residual_m:.3g} mm about its "
        f"surface where the budget, and what each pass scatters of its own, say "
        f"{1e3 * found.predicted_m:.3g} mm (p = {found.p_value:.1g}), so that position, attitude, "
        "calibration or clock are worse than given, or the surface changed on the way; "
        f"run `calibrate strips`, or give a true budget{group_words(found)}"
    )


def with_cover(
    survey: SurveyedSurface,
    footing: Footing,
    part: F64,
    volume: Volume,
    passes: PassAgreement,
    on_face: Bool,
    parameters: Parameters,
) -> Volume:
    """The volume with what grows on its ground, or on the body: as the user knows it, or where one
    scatters more than the other. on_face : (n,) vertices on steep faces
    """
    v = parameters.volume
    known = known_cover(v, len(footing.base.support) > 0)
    ground = 0.0 if known.ground else passes.cover_m
    body = 0.0 if known.body else passes.body_cover_m
    tin = survey.tin
    told, sigma = known.correction(tin, footing.base, part, v.object_height_m)
    found, doubts = cover_sigma(ground, body, volume.area_m2, volume.volume_m3)
    scatter = survey.patches.sigma[survey.sources.geometry.row[tin.source]]
    radius_m = parameters.filter.radius_m
    bush = 0.0 if known.body else bush_volume(tin, part, scatter, on_face, radius_m)
    doubts = doubts or bush_doubts(bush, volume.sigma_m3)
    cut, fill = with_net(volume.cut_m3, volume.fill_m3, told)
    volume = dataclasses.replace(
        volume,
        volume_m3=volume.volume_m3 + told,
        cut_m3=cut,
        fill_m3=fill,
        cover_m3=told,
        verdict=volume.verdict + Verdict(tuple(doubts)),
    )
    return with_line(volume, "vegetation", math.hypot(sigma, found, bush) ** 2)


def scaled_lines(volume: Volume, scales: Mapping[str, float]) -> Volume:
    """The volume with each line of its budget larger by a factor."""
    if max(scales.values(), default=1.0) == 1.0:
        return volume
    lines = {k: scales[k] * v for k, v in volume.budget_m6.items()}
    sigma = math.sqrt(sum(lines.values()))
    more = sigma / volume.sigma_m3 if volume.sigma_m3 > 0.0 else 1.0
    low, high = volume.sigma_tau_range_m3
    return dataclasses.replace(
        volume,
        sigma_m3=sigma,
        budget_m6=lines,
        budget_within_m6={k: scales[k] * v for k, v in volume.budget_within_m6.items()},
        sigma_tau_range_m3=(more * low, more * high),
    )


class PassAgreement(NamedTuple):
    """What the passes of a survey say of its budget. agreement : of their median with the budget,
    None where it tells nothing · cover_m, body_cover_m : by how much the ground scatters more than
    the body, and the body more than the ground · change : of the surface on the way
    """

    agreement: Agreement | None
    cover_m: float = 0.0
    body_cover_m: float = 0.0
    change: SurfaceChange | None = None


def ground_and_body(
    survey: SurveyedSurface, footing: Footing, object_height_m: float
) -> tuple[Bool, Bool]:
    """Which patches (m,) are of the ground that the base is fitted to, and which of the body."""
    tin, base = survey.tin, footing.base
    row = survey.sources.geometry.row[tin.source]
    height = height_above(tin.vertices, base)
    high = vertex_mask(tin, footing.inside > 0.0) & (height > object_height_m)
    ground, body = (np.zeros(len(survey.patches), np.bool_) for _ in range(2))
    ground[row[base.support]] = True
    body[row[high]] = True
    return ground, body


def scatters_slopes(agreement: Agreement) -> bool:
    """Whether a budget is refuted by errors that scatter the returns of slopes as plants do: they
    are much larger than stated, or nobody knows which they are. Beams scatter no return of its own.
    """
    freed = {s.name: s.scale for s in agreement.sources if s.scale > 1.0 and s.name != "noise"}
    beams = freed.pop("beams", 0.0)
    unknown = not freed and not beams
    return agreement.refuted and (unknown or any(s > SCATTERS**2 for s in freed.values()))


def covers(
    survey: SurveyedSurface, scatter: Scatter, ground: Bool, body: Bool, f: SurfaceFilterParameters
) -> tuple[float, float]:
    """By how much the ground scatters more than the body, m, and the body more than the ground, or
    than the noise where there is no ground to compare with; 0 where plants need not be the cause.
    ground, body : (m,) patches
    """
    patches, own = survey.patches, scatter.of_looks(survey.patches)

    def of_body(some: Bool) -> float:
        if ground.any():
            return cover_scatter(own or scatter, some, ground)
        return own_scatter(own, some) if own else 0.0

    cover, body_cover = cover_scatter(own or scatter, ground, body, OF_SLOPES), of_body(body)
    if body_cover > 0.0:  # or the body bends more than the fits do
        asked = scatter.rows[body[scatter.rows]]
        plain = plain_patches(patches.centre, patches.normal, asked, f.radius_m, f.degree)
        body_cover = of_body(body & plain)
    return cover, body_cover


def passes_of(survey: SurveyedSurface, footing: Footing, parameters: Parameters) -> PassAgreement:
    """The passes of a survey, the same for all of its bodies. Where the ground scatters more than
    the body it is overgrown: the body alone is asked. The ground is never asked alone: level ground
    does not show errors of attitude and of horizontal position.
    """
    nav, b = survey.sources.navigation, parameters.budget
    scatter = patch_scatter(survey.patches, nav, b)
    if scatter is None:
        return PassAgreement(None)
    ground, body = ground_and_body(survey, footing, parameters.volume.object_height_m)
    cover, body_cover = covers(survey, scatter, ground, body, parameters.filter)
    asked = scatter.of(body[scatter.rows]) if cover > 0.0 else scatter
    gap_s = parameters.georeference.max_position_gap_s
    agreement = pass_agreement(asked, survey.patches, nav, b, gap_s)
    # errors of position and attitude scatter slopes, and level ground does not show them
    if agreement is not None and (agreement.shift_m > 0.0 or scatters_slopes(agreement)):
        body_cover = 0.0
    change = surface_change(survey.patches, nav.bin_ns)
    return PassAgreement(agreement, cover, body_cover, change)


def change_of(
    survey: SurveyedSurface, part: F64, found: SurfaceChange | None
) -> tuple[float, Doubt | None]:
    """What changed of a body on the way, m³, and what to say of it; part (m,) m² of each
    triangle.
    """
    if found is None:
        return 0.0, None
    rows = survey.sources.geometry.row[survey.tin.source[vertex_mask(survey.tin, part > 0.0)]]
    own = np.isin(found.row, rows)
    more = float((found.area_m2 * found.by_m)[own].sum())
    if not more > 0.0:
        return 0.0, None
    start_ns = int(survey.patches.nav_bin.min()) * survey.sources.navigation.bin_ns
    return more, change_doubt(found, own, survey.patches.centre[found.row], start_ns)


def with_change(volume: Volume, more_m3: float, doubt: Doubt | None) -> Volume:
    """The volume of a body with what changed on it on the way."""
    if doubt is not None and more_m3 > CHANGED * volume.sigma_m3:
        volume = dataclasses.replace(volume, verdict=volume.verdict + Verdict((doubt,)))
    return with_line(volume, "changed", more_m3**2)


def with_faces(tin: Tin, part: F64, on_face: Bool, volume: Volume, kind: str) -> Volume:
    """The volume of a body, part (m,) m² of each triangle, with what its steep faces may hide or
    add. on_face : (n,) vertices on them · kind : what is measured.
    """
    doubted = {doubt.name: doubt.value or 0.0 for doubt in volume.verdict.doubts}
    if "wall" in doubted:
        wall = wall_m6(tin, part > 0.0) + enclosed_m6(tin, part, on_face)
        return with_line(volume, "wall", wall)
    if "object" in doubted:  # no more of it can be left, or be missing, than what was taken out
        volume = with_line(volume, "wall", min(wall_m6(tin, part > 0.0), doubted["object"] ** 2))
    found = steep_faces(tin, part, on_face)
    if found is None or found.sigma_m3 < NEGLIGIBLE * volume.sigma_m3:
        return volume
    if kind == "surface":  # closed bodies have walls of their own
        doubts = Verdict(tuple(edge_doubts(found, volume.volume_m3, volume.sigma_m3)))
        volume = dataclasses.replace(volume, verdict=volume.verdict + doubts)
    return with_line(volume, "edges", found.sigma_m3**2)


def with_surface(survey: SurveyedSurface, volume: Volume) -> Volume:
    """The volume with what the making of its surface leaves to doubt."""
    made, doubts = survey.surface, list[Doubt]()
    if not made.converged:
        words = (
            "the adjustment rms-iterated ended before its tolerance, and sigma is that of its "
            "limit: raise tin.max_iterations, or take tin.adjust rms"
        )
        doubts.append(Doubt("adjustment_unfinished", words))
    share = (made.screened_count + made.levelled_count) / max(len(survey.points), 1)
    if share > MOST_SCREENED:
        words = (
            f"median screen and filter changed {100 * share:.2g} % of the filtered points, corners "
            "and edges among them: raise tin.screen_m and tin.median_m"
        )
        doubts.append(Doubt("screened", words, share))
    return dataclasses.replace(volume, verdict=volume.verdict + Verdict(tuple(doubts)))


def with_objects(volume: Volume, objects: tuple[StandingObject, ...]) -> Volume:
    """The volume with what was taken out of the surface."""
    if not objects:
        return volume
    doubts = Verdict(tuple(object_doubts(objects, volume.sigma_m3)))
    return dataclasses.replace(volume, objects=objects, verdict=volume.verdict + doubts)


def edges_of(field: SurveyInField, volume_m3: float, sigma_m3: float) -> list[Doubt]:
    """Where a body ends, or goes on unseen."""
    doubts = field.surroundings.doubts(sigma_m3, field.parameters)
    if field.parameters.volume.outline == "all":
        doubts += notch_doubts(field.survey.tin, field.footing.base, volume_m3, sigma_m3)
    return doubts


def assess_field(field: SurveyInField, body: BodyInField, volume: Volume, ask: Ask) -> Volume:
    """A body's volume with every line and doubt of the field. ask : makes the slow checks, or
    gives what they found before.
    """
    footing, passes, parameters = field.footing, field.passes, field.parameters
    _, survey, part, vertex = body.on
    on_face = field.on_face if vertex is None else field.on_face[vertex]
    volume = with_surface(survey, volume)
    volume = with_passes(volume, passes.agreement, parameters.volume.budget_check)
    volume = with_cover(survey, footing, part, volume, passes, on_face, parameters)
    volume = with_change(volume, *ask("change", lambda: change_of(survey, part, passes.change)))
    volume = with_gaps(field, body.on, volume)
    volume = with_base(field, body, volume, ask)
    tin = survey.tin
    volume = with_objects(volume, body.objects)
    # a cut or a further body may be what makes the readings of the base differ
    chosen_m6 = volume.budget_m6.get("base_model", 0.0)
    sigma = math.sqrt(max(volume.sigma_m3**2 - chosen_m6, 0.0))
    net_m3 = volume.volume_m3
    doubts = ask(
        "completeness",
        lambda: edges_of(field, net_m3, sigma),
    )
    volume = dataclasses.replace(volume, verdict=volume.verdict + Verdict(tuple(doubts)))
    if any(doubt.name == "cut" for doubt in doubts):
        missing = ask("cut", lambda: cut_m6(tin, footing.base, part, net_m3, parameters))
        volume = with_line(volume, "cut", missing)
    return with_faces(tin, part, on_face, volume, parameters.volume.kind)

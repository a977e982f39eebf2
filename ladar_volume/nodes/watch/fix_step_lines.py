"""The largest step of the fixes on its way from georeference_node, which sees it, to volume_node,
whose passes it shifts: as lines of the diagnostics.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ladar_volume.georeference.fix_steps import FixStep, FixSteps, step_doubts
from ladar_volume.model.verdict import Verdict

#: Keys of the lines: times of the first fix after the step and of the first of all, ns; the step
#: east, north, up, and the median of what is fitted elsewhere, m.
AT, FIRST, STEP, USUAL = "fix_step_at_ns", "fix_first_ns", "fix_step_m", "fix_step_usual_m"


def step_lines(steps: FixSteps) -> dict[str, str]:
    """Of a step that stands out; none otherwise."""
    found = steps.largest()
    if found is None or steps.first_ns is None:
        return {}
    return {
        AT: str(found.t_ns),
        FIRST: str(steps.first_ns),
        STEP: " ".join(f"{float(v):.4f}" for v in found.step_m),
        USUAL: f"{found.usual_m:.6f}",
    }


def doubts_from_lines(lines: Mapping[str, str], verdict: Verdict) -> Verdict:
    """The doubt of a step in a node's lines, where the passes disagree."""
    try:
        step = np.array([float(v) for v in lines[STEP].split()])
        found = FixStep(int(lines[AT]), step, float(lines[USUAL]))
        first_ns = int(lines[FIRST])
    except (KeyError, ValueError):  # no step, or lines of a stranger
        return Verdict()
    return step_doubts(found, first_ns, verdict) if step.shape == (3,) else Verdict()

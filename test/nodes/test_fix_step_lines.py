"""A step of the fixes that georeference_node saw is a doubt of volume_node, as in a replay."""

import numpy as np

from ladar_volume.georeference.fix_steps import FixSteps, step_doubts
from ladar_volume.model.verdict import Doubt, Verdict
from ladar_volume.nodes.watch.fix_step_lines import STEP, doubts_from_lines, step_lines

BEGIN = 1_700_000_000_123_456_789
SHIFTED = Verdict((Doubt("passes_shifted", "passes lie apart", 0.2),))


def steps(size_m):
    found, rng = FixSteps(), np.random.default_rng(3)
    for k in range(300):
        t = 0.1 * k
        place = [9.0 * np.sin(0.3 * t), 8.0 * np.cos(0.2 * t), 25.0 + (size_m if t > 14.0 else 0.0)]
        found.add(BEGIN + k * 100_000_000, np.array(place) + rng.normal(0.0, 0.003, 3))
    return found


def test_a_step_arrives_as_replay_would_say_it():
    found = steps(0.2)
    lines = step_lines(found)
    (doubt,) = doubts_from_lines(lines, SHIFTED).doubts
    assert doubt == step_doubts(found.largest(), BEGIN, SHIFTED).doubts[0]
    assert "20 up" in doubt.text and "at 14.1 s" in doubt.text
    assert doubts_from_lines(lines, Verdict()) == Verdict()


def test_no_step_and_damaged_lines_say_nothing():
    assert step_lines(steps(0.0)) == {} and step_lines(FixSteps()) == {}
    lines = step_lines(steps(0.2))
    for text in ("", "1 2", "a b c"):
        assert doubts_from_lines(lines | {STEP: text}, SHIFTED) == Verdict()
    assert doubts_from_lines({}, SHIFTED) == Verdict()

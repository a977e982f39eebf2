"""Steps of the position are found with moment and size, and named where the passes disagree."""

import numpy as np
import pytest

from ladar_volume.georeference.fix_steps import SIDE, FixSteps, step_doubts
from ladar_volume.model.verdict import Doubt, Verdict

BEGIN = 1_700_000_000_000_000_000
SHIFTED = Verdict((Doubt("passes_shifted", "passes lie apart", 0.2),))


def path(step=(0.0, 0.0, 0.0), at_s=14.3, noise=0.004, seed=1, gap=None):
    """Lanes with turns, 10 Hz, 36 s, as an autopilot flies them, and a step from a moment on."""
    t = np.arange(0.0, 36.0, 0.1)
    p = np.column_stack([12.0 * np.sin(0.35 * t), 9.0 * np.sin(0.21 * t), 25.0 + 0.2 * np.cos(t)])
    p += noise * np.random.default_rng(seed).normal(size=p.shape)
    p[t >= at_s] += step
    found = FixSteps()
    for one, place in zip(t, p, strict=True):
        if gap is None or not gap[0] < one < gap[1]:
            found.add(BEGIN + round(one * 1e9), place)
    return found.largest()


@pytest.mark.parametrize(
    ("step", "at_s"), [((0.0, 0.12, -0.02), 14.3), ((0.1, 0.0, 0.0), 20.0), ((0.0, 0.05, 0.2), 5.1)]
)
def test_a_step_is_found_with_moment_and_size(step, at_s):
    found = path(step, at_s)
    assert found is not None
    assert abs((found.t_ns - BEGIN) * 1e-9 - at_s) < 0.11
    assert np.linalg.norm(found.step_m - step) < 0.3 * np.linalg.norm(step)


@pytest.mark.parametrize("seed", range(5))
def test_a_path_without_a_step_has_none(seed):
    assert path(seed=seed) is None


def test_a_gap_is_no_step():
    assert path(gap=(10.0, 13.0)) is None


def test_few_fixes_tell_nothing():
    found = FixSteps()
    for k in range(10):
        found.add(BEGIN + k * 100_000_000, np.array([k > 5, 0.0, 0.0]))
    assert found.largest() is None


def test_the_step_is_named_where_the_passes_disagree_and_only_there():
    found = path((0.0, 0.12, -0.02))
    (doubt,) = step_doubts(found, BEGIN, SHIFTED).doubts
    assert doubt.name == "fix_step" and doubt.value == pytest.approx(14.3, abs=0.11)
    assert "at 14.3 s" in doubt.text or "at 14.2 s" in doubt.text or "at 14.4 s" in doubt.text
    assert step_doubts(found, BEGIN, Verdict()) == Verdict()
    assert step_doubts(None, BEGIN, SHIFTED) == Verdict()


def test_a_window_is_full_with_as_many_fixes_before_the_step_as_after():
    found, said = FixSteps(), []
    for k in range(6 * SIDE):
        found.add(BEGIN + k * 100_000_000, np.array([0.2 * k + (k >= 18), 0.0, 0.0]))
        said.append(found.largest() is not None)
    first = said.index(True)
    assert first == 6 * SIDE - 2  # so many windows of twice the side as are asked for
    assert found.largest().t_ns == BEGIN + 18 * 100_000_000

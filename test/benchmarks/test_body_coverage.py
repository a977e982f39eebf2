"""No silent wrong volume: seeded clouds of the coverage study through the command line."""

import pytest

from benchmarks.body_coverage import answers


@pytest.mark.parametrize(
    ("kind", "seeds"),
    [
        ("sparse pile", range(200, 203)),
        ("pile", range(200, 202)),
        ("boulder from above", range(200, 201)),
        ("box", range(200, 201)),
    ],
)
def test_no_answer_is_wrong_in_silence(kind, seeds):
    for _, drawn, answer in answers(kind, seeds):
        assert answer.status != "refused", answer.say
        assert len(answer.error) == len(drawn.volume_m3)
        assert not answer.silent and answer.z < 3.0 and max(answer.sigma) < 0.25

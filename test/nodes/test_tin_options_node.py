"""volume_node with the options of seed 000: the section ``tin`` reaches its estimates, at launch
and at run time, and what has no effect is refused with a reason.
"""

import pytest
from own_process import result_of

SCRIPT = """
import json
import rclpy
from rclpy.parameter import Parameter
from volume_surfaces import cone, platform, surface_update
from ladar_volume.nodes.volume_node import VolumeNode
from ladar_volume.volume.estimator import VolumeEstimator

rclpy.init(args=[])
settings = {"volume.vertex_ratio": 0.3, "tin.bins_per_row": 20, "tin.exchange": "asd"}
settings |= {"filter.nav_bin_s": 1.0, "node.autostart": False}
node = VolumeNode(parameter_overrides=[Parameter(k, value=v) for k, v in settings.items()])
update = surface_update(lambda x, y: cone(x, y, slope=(0.02, -0.05)) + 3.0, perturb=0.01)


def volume():
    stage = VolumeEstimator(node.parameters)
    stage.add_platform(platform())
    stage.add(update)
    return stage.estimate(False).volume.volume_m3


out = [volume()]
node.trigger_configure()
answers = [
    node.set_parameters_atomically([Parameter(k, value=v) for k, v in changes.items()])
    for changes in (
        {"volume.vertex_ratio": 1.0},
        {"tin.exchange": "none", "tin.readjust": False},
        {"tin.exchange": "none", "tin.bins_per_row": 0, "tin.screen_m": 0.4},
    )
]
out.append(volume())
node.stage.add_platform(platform())
node.stage.add(update)
live = node.stage.estimate(False).volume.volume_m3
node.trigger_shutdown()
rclpy.try_shutdown()
said = [[a.successful, a.reason] for a in answers]
print(json.dumps({"volumes": out, "live": live, "answers": said}))
"""


@pytest.fixture(scope="module")
def seen():
    return result_of(SCRIPT, timeout_s=600)


def test_options_reach_the_estimates_of_the_node(seen):
    assert seen["volumes"][0] != seen["volumes"][1] and seen["live"] == seen["volumes"][1]


def test_what_has_no_effect_is_refused_at_run_time(seen):
    (full, why), (alone, _), (last, _) = seen["answers"]
    assert not full and "volume.vertex_ratio below 1" in why
    assert not alone and last

"""A worker's queue is bounded in items and in bytes; what does not fit is counted."""

from types import SimpleNamespace

from ladar_volume.model.losses import Losses
from ladar_volume.nodes import work_queue
from ladar_volume.nodes.base import StageNode
from ladar_volume.nodes.watch.health import Health
from ladar_volume.nodes.work_queue import QUEUE_BYTES, WorkQueue


def cloud(size):
    """What counts of a PointCloud2."""
    return SimpleNamespace(data=memoryview(bytes(size)), point_step=1)


def test_clouds_beyond_so_many_bytes_are_lost_by_name(monkeypatch):
    monkeypatch.setattr(work_queue, "QUEUE", 4)
    node = SimpleNamespace(health=Health(), losses=Losses(), queue=WorkQueue())
    most = cloud(QUEUE_BYTES)
    assert StageNode.offer(node, "points", cloud(2)) and not StageNode.offer(node, "points", most)
    assert StageNode.offer(node, "flush", None)  # what is no cloud has no size
    assert node.losses.as_dict() == {"message_queue_full_points": 1} and node.queue.bytes == 2
    assert node.queue.get_nowait()[0] == "points" and node.queue.bytes == 0
    assert StageNode.offer(node, "points", most)  # alone, any cloud goes
    assert not StageNode.offer(node, "points", cloud(1)) and StageNode.offer(
        node, "platform", SimpleNamespace(data=1.0)
    )
    node.queue.put(None)
    assert not StageNode.offer(node, "platform", None)  # the fifth of four
    assert node.losses.as_dict() == {
        "message_queue_full_points": 2,
        "message_queue_full_platform": 1,
    }
    assert [node.queue.get_nowait() is None for _ in range(4)] == [
        False,
        False,
        False,
        True,
    ] and node.queue.bytes == 0

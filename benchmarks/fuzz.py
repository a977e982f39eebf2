"""Mutated PointCloud2, NavSatFix and Imu messages into georeference_node: none may end it, and
every one must be accounted for.

A good flight's messages are mutated at random: stamps, numbers (NaN, infinite, huge, denormal),
covariances, quaternions, layouts that do not fit their data, cut, padded and flipped bytes, of the
data and of the message as it is sent. Then the books must balance: fixes and attitudes offered are
those in the trajectory plus those refused by name; clouds offered are those decoded plus those
refused; returns decoded are those mapped plus those lost.

``python -m benchmarks.fuzz [--count N] [--seed S]``; exit code 1 where the books do not balance or
an unforeseen exception occurred.
"""

from __future__ import annotations

import argparse
import array
import json
import random
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, NavSatFix, PointCloud2

from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.model.records import Fix, Returns
from ladar_volume.nodes.convert import header, table_message
from ladar_volume.nodes.georeference_node import GeoreferenceNode
from ladar_volume.process.private_graph import join_private_graph

S = 1_000_000_000
NUMBERS = (
    float("nan"),
    float("inf"),
    float("-inf"),
    0.0,
    -0.0,
    5e-324,
    1e308,
    -1e308,
    1e-300,
    1.0,
    -1.0,
    91.0,
    361.0,
)


class Booked(Georeferencer):
    """Counts what is taken in and given out."""

    def __init__(self, parameters: Any) -> None:
        super().__init__(parameters)
        self.book = dict.fromkeys(("fix", "imu", "cloud", "returns", "mapped"), 0)

    def _add_position(self, fix: Fix, C_enu: Any) -> None:
        self.book["fix"] += 1
        super()._add_position(fix, C_enu)

    def _refer(self, t_ns: int) -> None:
        self.book["imu"] += 1
        super()._refer(t_ns)

    def add_returns(self, returns: Returns) -> None:
        """As the stage, booked."""
        self.book["cloud"] += 1
        self.book["returns"] += len(returns)
        super().add_returns(returns)

    def take_points(self) -> list[Any]:
        """As the stage, booked."""
        out = super().take_points()
        self.book["mapped"] += sum(len(p) for p in out)
        return out


def good(kind: str, t_ns: int, rng: np.random.Generator) -> Any:
    """A message as a sensor sends it."""
    if kind == "fix":
        message = NavSatFix(
            header=header(t_ns, "gnss"),
            latitude=50.0,
            longitude=14.0 + rng.normal() * 1e-6,
            altitude=30.0,
        )
        message.position_covariance_type = 2
        message.position_covariance = np.diag([1e-4] * 3).ravel()
        message.status.status = 2
        return message
    if kind == "imu":
        message = Imu(header=header(t_ns, "imu"))
        message.orientation.w = 1.0
        message.orientation_covariance = np.diag([1e-6] * 3).ravel()
        return message
    n = int(rng.integers(1, 400))
    columns = {axis: rng.uniform(-20, 20, n).astype(np.float32) for axis in "xyz"}
    columns |= {
        "intensity": np.ones(n, np.float32),
        "ring": rng.integers(0, 16, n).astype(np.uint16),
    }
    columns["time"] = np.linspace(-0.1, 0.0, n).astype(np.float32)
    return table_message(columns, t_ns, "velodyne")


def _stamp(message: Any, random_: random.Random) -> None:
    stamp = message.header.stamp
    kind = random_.randrange(4)
    if kind == 0:
        stamp.sec, stamp.nanosec = (
            random_.choice((-(2**31), -1, 0, 2**31 - 1)),
            random_.choice((0, 999_999_999, 2**32 - 1)),
        )
    elif kind == 1:
        stamp.sec = max(
            -(2**31),
            min(2**31 - 1, stamp.sec + random_.choice((-3600, -30, -3, -1, 1, 3, 30, 3600))),
        )
    elif kind == 2:
        stamp.nanosec = random_.randrange(2**32)
    else:
        stamp.sec = random_.randrange(-(2**31), 2**31)


def _number(message: Any, random_: random.Random) -> None:
    value = random_.choice(NUMBERS)
    if isinstance(message, NavSatFix):
        field = random_.choice(
            ("latitude", "longitude", "altitude", "covariance", "type", "status")
        )
        if field == "covariance":
            message.position_covariance[random_.randrange(9)] = value
        elif field == "type":
            message.position_covariance_type = random_.randrange(256)
        elif field == "status":
            message.status.status = random_.randrange(-128, 128)
        else:
            setattr(message, field, value)
    else:
        field = random_.choice(
            (
                "orientation",
                "angular_velocity",
                "orientation_covariance",
                "angular_velocity_covariance",
            )
        )
        if field.endswith("covariance"):
            getattr(message, field)[random_.randrange(9)] = value
        else:
            setattr(
                getattr(message, field),
                random_.choice("xyz" if field == "angular_velocity" else "xyzw"),
                value,
            )


def _layout(cloud: PointCloud2, random_: random.Random) -> None:
    name = random_.choice(
        (
            "height",
            "width",
            "point_step",
            "row_step",
            "is_bigendian",
            "field",
            "field",
            "drop",
            "twice",
        )
    )
    if name == "is_bigendian":
        cloud.is_bigendian = not cloud.is_bigendian
    elif name == "field":
        field = random_.choice(cloud.fields)
        what = random_.choice(("name", "offset", "datatype", "count"))
        sizes = {
            "offset": (0, 1, 3, 25, 4096, 2**32 - 1),
            "datatype": (*range(12), 255),
            "count": (0, 1, 2, 65_536, 2**32 - 1),
        }
        value = (
            random_.choice(("x", "y", "time", "t", "timestamp", "", "ü", "ring"))
            if what == "name"
            else random_.choice(sizes[what])
        )
        setattr(field, what, value)
    elif name in ("drop", "twice"):
        fields = list(cloud.fields)
        fields = fields[:-1] if name == "drop" else [*fields, random_.choice(fields)]
        random_.shuffle(fields)
        cloud.fields = fields
    else:
        old = getattr(cloud, name)
        setattr(
            cloud, name, random_.choice((0, 1, max(old - 1, 0), old + 1, 2 * old, 2**31, 2**32 - 1))
        )


def _bytes(cloud: PointCloud2, random_: random.Random) -> None:
    data = bytearray(cloud.data)
    kind = random_.randrange(4)
    if kind == 0:
        data = data[: random_.randrange(len(data) + 1)]
    elif kind == 1:
        data += random_.randbytes(random_.randrange(1, 99))
    elif kind == 2:
        for _ in range(random_.randrange(1, 200)):
            data[random_.randrange(len(data))] = random_.randrange(256)
    else:
        data = bytearray(random_.randbytes(len(data)))
    cloud.data = array.array("B", bytes(data))


def mutate(message: Any, random_: random.Random) -> None:
    """One to three random changes in place."""
    changes: list[Callable[[Any, random.Random], None]] = [_stamp, _number]
    if isinstance(message, PointCloud2):
        changes = [_stamp, _layout, _bytes]
    for _ in range(random_.randrange(1, 4)):
        change = random_.choice(changes)
        if change is not _bytes or len(message.data):
            change(message, random_)


def _on_the_way(data: bytes, random_: random.Random) -> bytes:
    """What the middleware hands over of a message: cut, flipped in its head, or something else
    altogether.
    """
    kind, out = random_.randrange(3), bytearray(data)
    if kind == 0:
        return data[: random_.randrange(len(data))]
    if kind == 1:
        for _ in range(random_.randrange(1, 9)):
            out[random_.randrange(min(len(data), 200))] = random_.randrange(256)
        return bytes(out)
    return random_.randbytes(random_.randrange(400))


def play(node: GeoreferenceNode, count: int, seed: int) -> dict[str, int]:
    """Have the node take in ``count`` mutated messages, a good one of the same kind before each,
    and finish; a quarter of them changes once more on the way, as bytes. Returns how many of each
    kind were offered.
    """
    rng, random_ = np.random.default_rng(seed), random.Random(seed)
    offered = dict.fromkeys(("fix", "imu", "cloud"), 0)
    for k in range(count):
        t_ns = 1_000 * S + k * S // 100
        kind = ("fix", "imu", "cloud")[k % 3]
        for bad in (False, True):
            message = good(kind, t_ns + bad * S // 1000, rng)
            if bad:
                mutate(message, random_)
            data = serialize_message(message)
            offered[kind] += 1
            node.receive(
                kind,
                type(message),
                _on_the_way(data, random_) if bad and random_.random() < 0.25 else data,
            )
            while node.queue.qsize() > 100:
                time.sleep(0.001)
    node.stop()
    return offered


def balance(node: GeoreferenceNode, offered: dict[str, int]) -> dict[str, int]:
    """What the books lack or have too much: zeros where every message and return is accounted
    for.
    """
    stage: Any = node.stage
    lost = node.all_losses()
    missing = {
        kind: n - stage.book[kind] - lost.total(f"{kind}_") - lost[f"message_unreadable_{kind}"]
        for kind, n in offered.items()
    }
    missing["returns"] = stage.book["returns"] - stage.book["mapped"] - stage.losses.total("point_")
    return missing | {"unforeseen": lost["message_internal_error"]}


def fuzz(count: int, seed: int) -> dict[str, Any]:
    """``count`` mutated messages: ``missing`` from the books, what was ``taken``, and the
    ``losses`` by reason.
    """
    join_private_graph()
    rclpy.init(args=[])
    try:
        node = GeoreferenceNode(
            parameter_overrides=[Parameter("georeference.max_pending_s", value=1.0)]
        )
        node.trigger_configure()
        node.trigger_activate()
        stage = Booked(node.parameters)
        node.stage = stage
        offered = play(node, count, seed)
        losses = node.all_losses().as_dict()
        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    refused = {k: n for k, n in losses.items() if not k.startswith("point_")}
    return {
        "missing": balance(node, offered),
        "offered": offered,
        "taken": stage.book,
        "restarts": stage.restarts,
        "losses": losses,
        "refused": sum(refused.values()),
        "reasons": len(refused),
    }


GOALS = {
    "unforeseen exceptions": (0.0, 0.0),
    "unaccounted messages and returns": (0.0, 0.0),
    "reasons": (15.0, 1e9),
}


def run() -> dict[str, float | int | str]:
    """Ten thousand mutated messages."""
    out = fuzz(10_000, 1)
    return {
        "mutated messages": 10_000,
        "unforeseen exceptions": out["missing"]["unforeseen"],
        "unaccounted messages and returns": sum(abs(n) for n in out["missing"].values()),
        "refused messages": out["refused"],
        "reasons": out["reasons"],
    }


def main() -> int:
    """Print what was found as JSON."""
    parser = argparse.ArgumentParser(description="mutated sensor messages")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    out = fuzz(arguments.count, arguments.seed)
    print(json.dumps(out))
    return int(any(out["missing"].values()))


if __name__ == "__main__":
    sys.exit(main())

"""Intermediate volumes over the wire's tables equal offline estimates of the same prefix."""

import ast
from pathlib import Path
from types import SimpleNamespace as Message

import numpy as np
import pytest

from ladar_volume.georeference.georeferencer import Georeferencer
from ladar_volume.io import message_tables
from ladar_volume.io.bags import BagReader
from ladar_volume.io.cloud_messages import returns_from_cloud
from ladar_volume.io.config import read_config
from ladar_volume.io.sensor_messages import fix_from_message, imu_from_message
from ladar_volume.io.tables import NUMBERS, decode, encode
from ladar_volume.model.losses import Losses
from ladar_volume.pipeline import Engine
from ladar_volume.rmls.surface_filter import SurfaceFilter
from ladar_volume.volume.estimator import VolumeEstimator

ROOT = Path(__file__).parents[2]


def sent(columns):
    """Columns through a message and back."""
    t = encode(columns)
    fields = [
        Message(name=c.name, offset=c.offset, datatype=NUMBERS[c.code], count=c.count)
        for c in t.columns
    ]
    return decode(
        Message(
            width=t.rows,
            height=1,
            point_step=t.row_bytes,
            row_step=t.row_bytes * t.rows,
            is_bigendian=False,
            fields=fields,
            data=t.data.tobytes(),
        )
    )


def samples(seconds):
    with BagReader(ROOT / "bags" / "stockpile") as bag:
        end = bag.start_ns + int(seconds * 1e9)
        return [(r.topic, bag.message(r)) for r in bag.raw() if r.t_ns <= end]


def feed(stage, parameters, topic, message):
    if topic == "gnss/fix":
        stage.add_fix(fix_from_message(message))
    elif topic == "imu/data":
        stage.add_imu(imu_from_message(message))
    else:
        stage.add_returns(returns_from_cloud(message, parameters.georeference, Losses()))


def test_every_intermediate_volume_is_that_of_the_offline_prefix():
    parameters = read_config(
        ROOT / "bags" / "stockpile" / "config.yaml", ["filter.radius_m=1.0", "filter.trials=10"]
    )
    georeferencer, surface, estimator = (
        Georeferencer(parameters),
        SurfaceFilter(parameters),
        VolumeEstimator(parameters),
    )
    messages = samples(16.0)
    prefixes = (len(messages) * 5 // 8, len(messages))
    for i, (topic, message) in enumerate(messages, 1):
        feed(georeferencer, parameters, topic, message)
        states = georeferencer.take_platform()
        if states is not None:
            surface.add_platform(states)
            estimator.add_platform(states)
        for points in georeferencer.take_points():
            stamp, columns = message_tables.mapped_columns(points)
            surface.add(message_tables.mapped_points(stamp, sent(columns)))
        if i not in prefixes:
            continue
        for part in message_tables.update_parts(surface.update(), 300):
            rows = sent(message_tables.filtered_columns(part.points)) if len(part.points) else None
            estimator.add(
                message_tables.filter_update(
                    message_tables.filtered_points(rows)
                    if rows
                    else message_tables.no_filtered_points(),
                    sent(message_tables.patch_columns(part)),
                )
            )
        online = estimator.estimate().volume
        engine = Engine(parameters)
        for t, m in messages[:i]:
            feed(engine, parameters, t, m)
        offline = engine.estimate().volume
        assert online.volume_m3 == offline.volume_m3
        assert online.sigma_m3 == pytest.approx(offline.sigma_m3, rel=1e-5)


def test_launch_files_name_the_nodes_that_exist():
    tree = ast.parse((ROOT / "launch" / "online.launch.py").read_text())
    words = {
        n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)
    }
    for node in ("georeference_node", "filter_node", "volume_node", "logger_node", "mavlink_node"):
        assert node in words and (ROOT / "ladar_volume" / "nodes" / f"{node}.py").is_file()
    assert np.all([w != "rosbag2_py" for w in words])

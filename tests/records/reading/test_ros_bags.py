"""Bags of ROS 2, made with rosbags: topics, headers, nested fields."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

import riecjax as rx
from damage import damaged, outcome
from riecjax.records.reading.read import read_channels

STORE = get_typestore(Stores.ROS2_HUMBLE)
COUNT, STEP = 50, 10_000_000
START = 1_709_294_400_000_000_000
X = np.sin(0.01 * np.arange(COUNT))


def bag(folder, storage=StoragePlugin.MCAP, late=0):
    """Accelerations with headers, logged `late` by up to 3 ms; a force on another topic."""
    types = STORE.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, number = types["geometry_msgs/msg/Vector3Stamped"], types["std_msgs/msg/Float64"]
    with Writer(folder, version=9, storage_plugin=storage) as out:
        imu = out.add_connection("/imu", vector.__msgtype__, typestore=STORE)
        force = out.add_connection("/force", number.__msgtype__, typestore=STORE)
        for i, x in enumerate(X):
            seconds, rest = divmod(START + STEP * i, 10**9)
            at = types["geometry_msgs/msg/Vector3"](x, 2 * x, 0.0)
            message = vector(header(stamp(seconds, rest), "rig"), at)
            logged = START + STEP * i + late * (i % 4)
            out.write(imu, logged, STORE.serialize_cdr(message, vector.__msgtype__))
            packed = STORE.serialize_cdr(number(3 * x), number.__msgtype__)
            out.write(force, START + STEP * i, packed)
    return folder


@pytest.mark.portable
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_folder_of_two_topics(tmp_path, storage):
    path = bag(tmp_path / "bag", storage)
    channels = read_channels(path)
    np.testing.assert_array_equal(channels.columns["/imu.vector.y"], 2 * X)
    np.testing.assert_array_equal(channels.columns["/force.data"], 3 * X)
    record = rx.read_record(path, rename={"a": "/imu.vector.x", "F": "/force.data"})
    np.testing.assert_array_equal(record["a"], X)
    assert float(record.time_step) == pytest.approx(0.01)


def test_time_is_that_of_the_headers(tmp_path):
    path = bag(tmp_path / "bag", late=1_000_000)
    channels = read_channels(path)
    expected = 0.01 * np.arange(COUNT)
    np.testing.assert_allclose(channels.columns["/imu.time"], expected, atol=1e-12)
    assert "topic '/imu': time by its headers" in channels.notes


@pytest.mark.slow
def test_damaged_files(tmp_path):
    content = next(bag(tmp_path / "bag").glob("*.mcap")).read_bytes()
    rng = np.random.default_rng(20240501)
    refused = [outcome(tmp_path / "a.mcap", damaged(content, rng)) for _ in range(10)]
    assert sum(message is not None for message in refused) > 4

"""Writes bags of ROS 2 with the public package `rosbags`: python bags.py BAGS.json

BAGS.json is a list of bags. Each has a `path`, a `storage` (mcap or sqlite3), a `compression`
(none, storage, message or file), `is_big_endian`, an `encoding`, and `messages`: time of recording
and of the header [ns], topic, type, numbers and names. A number that is null becomes NaN.
"""

import json
import sys
from pathlib import Path

import numpy
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)


def make(kind, **fields):
    return STORE.types[kind](**fields)


def header(nanos):
    stamp = make("builtin_interfaces/msg/Time", sec=nanos // 10**9, nanosec=nanos % 10**9)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id="odom")


def twist(forward, left, yaw):
    vector = "geometry_msgs/msg/Vector3"
    return make(
        "geometry_msgs/msg/Twist",
        linear=make(vector, x=forward, y=left, z=0.0),
        angular=make(vector, x=0.0, y=0.0, z=yaw),
    )


def odometry(nanos, numbers):
    x, y, *quaternion, forward, left, yaw = numbers
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
        orientation=make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", quaternion))),
    )
    none = numpy.zeros(36)
    return make(
        "nav_msgs/msg/Odometry",
        header=header(nanos),
        child_frame_id="base_link",
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=none),
        twist=make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=twist(forward, left, yaw),
            covariance=none,
        ),
    )


def message(kind, nanos, numbers, names):
    match kind:
        case "nav_msgs/msg/Odometry":
            return odometry(nanos, numbers)
        case "geometry_msgs/msg/Twist":
            return twist(*numbers)
        case "geometry_msgs/msg/TwistStamped":
            return make(kind, header=header(nanos), twist=twist(*numbers))
        case "sensor_msgs/msg/JointState":
            speeds, none = numpy.array(numbers), numpy.zeros(0)
            fields = {"name": names, "position": none, "velocity": speeds, "effort": none}
            return make(kind, header=header(nanos), **fields)
        case "std_msgs/msg/String":
            return make(kind, data=names[0])
    raise ValueError(kind)


def write(bag):
    plugin = StoragePlugin[bag["storage"].upper()]
    writer = Writer(bag["path"], version=9, storage_plugin=plugin)
    writer.set_compression(CompressionMode[bag["compression"].upper()], CompressionFormat.ZSTD)
    topics = {}
    with writer:
        for recorded, nanos, topic, kind, numbers, names in bag["messages"]:
            if topic not in topics:
                topics[topic] = writer.add_connection(
                    topic, kind, typestore=STORE, serialization_format=bag["encoding"]
                )
            numbers = [float("nan") if number is None else number for number in numbers]
            encoded = STORE.serialize_cdr(
                message(kind, nanos, numbers, names),
                kind,
                little_endian=not bag["is_big_endian"],
            )
            writer.write(topics[topic], recorded, encoded)


for bag in json.loads(Path(sys.argv[1]).read_text()):
    write(bag)

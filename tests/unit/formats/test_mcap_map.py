"""A map as MCAP, read back by the format's own reader."""

from __future__ import annotations

import base64
import io
import json

import numpy as np
import pytest
from mcap.reader import make_reader

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.formats.mcap_map import DrivenPoses, encode

STAMP_NS = 1_700_000_000_123_456_789


def drive(yaw, count):
    poses = np.stack([se3.from_yaw(yaw, (float(step), 2.0 * yaw, 0.5)) for step in range(count)])
    return DrivenPoses(STAMP_NS + 10**9 * np.arange(count), poses)


def messages(data):
    found = {}
    for schema, channel, message in make_reader(io.BytesIO(data)).iter_messages():
        found[channel.topic] = (schema.name, message.log_time, json.loads(message.data))
    return found


def placed(cloud):
    """The points of a cloud where its pose puts them; it may not turn them."""
    assert cloud["pose"]["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    origin = [cloud["pose"]["position"][axis] for axis in "xyz"]
    return np.frombuffer(base64.b64decode(cloud["data"]), "<f4").reshape(-1, 3) + np.array(origin)


def test_a_cloud_in_utm_is_exact_to_the_millimetre():
    points = np.array([[500123.4567, 5400321.7894, 110.25], [500160.123, 5400300.001, 108.0]])
    _, _, cloud = messages(encode({}, points))["/map/cloud"]
    np.testing.assert_allclose(placed(cloud), points, rtol=0, atol=1e-5)


def test_poses_cloud_and_lines_come_back():
    drives, points = {"monday": drive(0.3, 4), "tuesday": drive(-1.0, 2)}, np.float32([[1, 2, 3], [4, 5, 6.5]])
    found = messages(encode(drives, points, "frame-1"))
    assert list(found) == ["/map/poses/monday", "/map/poses/tuesday", "/map/cloud", "/map/sessions"]
    name, stamp_ns, poses = found["/map/poses/monday"]
    assert (name, stamp_ns, poses["frame_id"]) == ("foxglove.PosesInFrame", STAMP_NS, "frame-1")
    for told, T in zip(poses["poses"], drives["monday"].T_map_submap, strict=True):
        q, p = ([told[part][axis] for axis in axes] for part, axes in (("orientation", "xyzw"), ("position", "xyz")))
        np.testing.assert_allclose(se3.from_quaternion(q, p), T, atol=1e-12)
    _, _, cloud = found["/map/cloud"]
    assert [(field["name"], field["offset"], field["type"]) for field in cloud["fields"]] == [
        ("x", 0, 7), ("y", 4, 7), ("z", 8, 7),
    ]  # fmt: skip
    np.testing.assert_array_equal(placed(cloud), points)
    _, _, scene = found["/map/sessions"]
    assert [entity["id"] for entity in scene["entities"]] == ["monday", "tuesday"]
    assert [len(entity["lines"][0]["points"]) for entity in scene["entities"]] == [4, 2]
    assert cloud["timestamp"] == {"sec": STAMP_NS // 10**9, "nsec": STAMP_NS % 10**9}


def test_the_same_map_gives_the_same_bytes_and_damage_is_refused():
    drives = {"monday": drive(0.0, 2)}
    assert encode(drives, np.zeros((3, 3))) == encode(drives, np.zeros((3, 3)))
    with pytest.raises(BadField):
        encode(drives, np.full((1, 3), np.nan))

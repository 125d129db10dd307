"""The tree of a bag's transforms."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.evaluation.datasets.ros_messages import StampedTransform
from revisit.evaluation.datasets.transform_tree import TransformTree

OLD, NEW = se3.from_yaw(-0.5, (0.0, 0.0, 3.0)), se3.from_yaw(0.5, (0.9, 0.1, 1.2))


@pytest.mark.parametrize(("moving", "stamps"), [(False, (0, 0)), (False, (5, 9)), (False, (9, 5)), (True, (0, 0))])
def test_a_static_transform_is_the_one_that_was_told_last(moving: bool, stamps: tuple[int, int]) -> None:
    told = [StampedTransform(stamp, "base", "lidar", pose) for stamp, pose in zip(stamps, (OLD, NEW), strict=True)]
    tree = TransformTree(told if moving else [], [] if moving else told)
    np.testing.assert_allclose(tree.at("base", "lidar", 7), NEW)


def test_what_is_told_again_and_again_alike_is_not_what_carries_a_sensor() -> None:
    moving = [StampedTransform(t, "odom", "base", se3.from_yaw(0.1 * t)) for t in range(3)]
    moving += [StampedTransform(t, "base", "lidar", NEW) for t in range(3)]
    tree = TransformTree(moving, [])
    assert tree.carrier("lidar") == "base" and tree.moved(["odom"]) == ["base"] == tree.moved([])
    assert tree.carrier("odom") is None

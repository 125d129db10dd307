"""Warnings of the SDK about what is sent: once for each kind of mistake, none for a sound drive, never an error."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.formats import NPY, encode_npy
from revisit.sdk.clouds import Cloud
from revisit.sdk.input_watch import InputWatch, SuspiciousInput

START_NS = 1_700_000_000 * 10**9
PITCHED = se3.exp([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
RNG = np.random.default_rng(3)
WORLD = np.concatenate(
    [
        np.column_stack([RNG.uniform(-40, 40, (9000, 2)), RNG.normal(0.0, 0.01, 9000)]),
        np.column_stack([RNG.uniform(-40, 40, 3000), np.repeat([-9.0, 9.0, 30.0], 1000), RNG.uniform(0, 6, 3000)]),
    ]
)


def told(
    count: int = 16, scale: float = 1.0, period_ns: int = 10**8, turned=np.eye(4), jump_m: float = 0.0, encode=None
):
    """The warnings of a drive of `count` scans half a metre apart."""
    watch = InputWatch()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for index in range(count):
            pose = se3.from_yaw(0.02 * index, (0.5 * index, 0.0, 1.6))
            seen = scale * se3.apply(se3.inverse(pose), WORLD)
            pose[0, 3] += jump_m * (index > count // 2)
            watch.look(
                encode(seen) if encode else seen, turned @ pose, START_NS // 10**8 * period_ns + index * period_ns
            )
    assert all(issubclass(warning.category, SuspiciousInput) for warning in caught)
    return [str(warning.message) for warning in caught]


def test_a_sound_drive_is_not_warned_about() -> None:
    assert told(420) == []


@pytest.mark.parametrize(
    ("mistake", "code", "cause"),
    [
        ({"scale": 100.0}, "scene_too_large", "the points are in centimetres"),
        ({"scale": 0.001}, "scene_too_small", "kilometres"),
        ({"period_ns": 10**5}, "time_unit", "microseconds"),
        ({"jump_m": 5_000.0}, "pose_jump", "GNSS"),
        ({"turned": PITCHED}, "ground_tilted", "no z up"),
    ],
    ids=["centimetres", "kilometres", "microseconds", "jumps", "pitched"],
)
def test_a_mistake_is_told_once_with_its_cause(mistake, code, cause) -> None:
    messages = [message for message in told(210, **mistake) if message.startswith(f"{code}:")]
    assert len(messages) == 1 and cause in messages[0]


def test_of_clouds_that_are_encoded_already_only_poses_and_times_are_looked_at() -> None:
    encode = lambda points: Cloud(encode_npy(points.astype(np.float32)), NPY)  # noqa: E731
    assert told(scale=100.0, encode=encode) == []
    assert any(message.startswith("pose_jump") for message in told(jump_m=900.0, encode=encode))


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.full((500, 3), np.nan), np.ones((500, 2)), "nonsense"], ids=repr
)
@pytest.mark.parametrize("pose", [np.eye(4), np.zeros((4, 4)), np.eye(2), None], ids=["pose", "zeros", "small", "none"])
def test_what_the_service_will_refuse_raises_nothing_here(points, pose) -> None:
    watch = InputWatch()
    for index in range(20):
        watch.look(points, pose, index)


def test_scans_that_the_service_will_refuse_are_told_of_once_before_they_are_sent() -> None:
    (millimetres,) = told(3, scale=1000.0)
    assert "UNUSABLE_CLOUD" in millimetres
    assert "metres, not millimetres" in millimetres

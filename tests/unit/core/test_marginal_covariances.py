"""The covariances of all poses of a graph are those that gtsam computes one by one."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

from revisit.core.pose_graph import marginal_covariances as tested
from revisit.core.pose_graph.marginal_covariances import marginal_covariances

POSES = 60


def noise(rng: np.random.Generator) -> gtsam.noiseModel.Gaussian:
    root = rng.normal(size=(6, 6)) * 0.02 + np.diag(rng.uniform(0.02, 0.2, 6))
    return gtsam.noiseModel.Gaussian.Covariance(root @ root.T)


def made(seed: int, loops: int, anchored: int = 1, parts: int = 1) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Chains of poses, each held at its beginning where `anchored`, with loops at random within them."""
    rng = np.random.default_rng(seed)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    each = POSES // parts
    for key in range(POSES):
        values.insert(key, gtsam.Pose3.Expmap(rng.normal(size=6)))
        if key % each == 0:
            if anchored:
                factors.add(gtsam.PriorFactorPose3(key, values.atPose3(key), noise(rng)))
            continue
        factors.add(gtsam.BetweenFactorPose3(key - 1, key, gtsam.Pose3.Expmap(rng.normal(size=6)), noise(rng)))
    for _ in range(loops):
        first = int(rng.integers(POSES))
        second = int(rng.integers(each)) + first // each * each
        if first != second:
            motion = gtsam.Pose3.Expmap(rng.normal(size=6))
            factors.add(gtsam.BetweenFactorPose3(first, second, motion, noise(rng)))
    return factors, values


@pytest.mark.parametrize(("seed", "loops", "parts"), [(1, 0, 1), (2, 3, 1), (3, 40, 1), (4, 300, 1), (5, 30, 3)])
def test_the_covariance_of_each_pose_is_that_of_gtsam(seed: int, loops: int, parts: int) -> None:
    factors, values = made(seed, loops, parts=parts)
    expected = gtsam.Marginals(factors, values)
    found = marginal_covariances(factors, values)
    assert found is not None and sorted(found) == list(range(POSES))
    for key in range(POSES):
        np.testing.assert_allclose(found[key], expected.marginalCovariance(key), rtol=1e-7, atol=1e-10)


def test_poses_that_nothing_holds_have_no_covariances() -> None:
    assert marginal_covariances(*made(6, 5, anchored=0)) is None


def test_what_is_known_of_poses_together_is_let_go_of_when_nothing_needs_it(monkeypatch) -> None:
    alive, most = set[int](), 0
    front = tested._front

    def watched(key, one, parent, waiting):
        nonlocal most
        made = front(key, one, parent, waiting)
        if parent is not None and parent.waiting == 1:
            alive.discard(id(parent))
        if waiting:
            alive.add(id(made))
        most = max(most, len(alive))
        return made

    monkeypatch.setattr(tested, "_front", watched)
    assert marginal_covariances(*made(1, 0)) is not None
    assert 0 < most < POSES / 4  # a chain, eliminated in several places at once

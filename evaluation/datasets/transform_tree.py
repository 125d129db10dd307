"""The tree of frames that a bag's transforms make, as ROS has it: each frame has one parent."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.evaluation.datasets.posed_clouds import StampedPoses, Stamps
from revisit.evaluation.datasets.ros_messages import StampedTransform

SAME = 1e-6
"""Transforms whose elements differ by less are one: static ones are also told again and again on /tf."""


@dataclass(frozen=True)
class _Edge:
    """Where a frame is in its parent, and the times in the order of the bag; a static transform holds for ever."""

    parent: str
    poses: StampedPoses
    moves: bool
    stamps_ns: Stamps

    @property
    def changes(self) -> bool:
        """Whether it is told more than once, and not always the same."""
        poses = self.poses.T_world_body
        return self.moves and not np.allclose(poses, poses[0], rtol=0.0, atol=SAME)

    def covered(self, stamps_ns: Stamps) -> NDArray[np.bool_]:
        return self.poses.covered(stamps_ns) if self.moves else np.ones(len(stamps_ns), dtype=bool)

    def at(self, stamp_ns: int) -> se3.Matrix4:
        return self.poses.at(stamp_ns) if self.moves else np.asarray(self.poses.T_world_body[-1])


class TransformTree:
    """Frames and how they lie in each other at any time."""

    def __init__(self, moving: Iterable[StampedTransform], fixed: Iterable[StampedTransform]) -> None:
        """From the transforms of /tf and those of /tf_static. A frame keeps the parent that is told first."""
        self._edges: dict[str, _Edge] = {}
        for transforms, moves in ((fixed, False), (moving, True)):
            samples_of: dict[str, list[StampedTransform]] = {}
            for transform in transforms:
                if transform.child not in self._edges:
                    samples_of.setdefault(transform.child, []).append(transform)
            self._edges |= {child: _edge(samples, moves) for child, samples in samples_of.items()}

    @property
    def frames(self) -> set[str]:
        """All frames that have a parent."""
        return set(self._edges)

    def ancestors(self, frame: str) -> list[str]:
        """The frame's parent, its parent and so on; a circle ends where it closes."""
        found: list[str] = []
        while frame in self._edges and self._edges[frame].parent not in found:
            frame = self._edges[frame].parent
            found.append(frame)
        return found

    def carrier(self, frame: str) -> str | None:
        """The frame itself, or else the first one above it, whose place in its parent changes."""
        return next((above for above in (frame, *self.ancestors(frame)) if self._changes(above)), None)

    def moved(self, within: Collection[str]) -> list[str]:
        """The frames whose place changes in one of `within`; where there are none, in what nothing else moves."""
        changing = [frame for frame in self._edges if self._changes(frame)]
        inside = [frame for frame in changing if self._edges[frame].parent in within]
        return inside or [frame for frame in changing if self.carrier(self._edges[frame].parent) is None]

    def parent(self, frame: str) -> str:
        """The parent of a frame that has one."""
        return self._edges[frame].parent

    def _changes(self, frame: str) -> bool:
        return frame in self._edges and self._edges[frame].changes

    def linked(self, target: str, source: str) -> bool:
        """Whether the transform between two frames can be told."""
        return self._meeting(target, source) is not None

    def moves(self, target: str, source: str) -> bool:
        """Whether anything moves on the way between two linked frames."""
        return any(edge.moves for edge in self._way(target, source))

    def covered(self, target: str, source: str, stamps_ns: Stamps) -> NDArray[np.bool_]:
        """At which of the times the transform between two linked frames is known."""
        masks = [edge.covered(stamps_ns) for edge in self._way(target, source)]
        return np.logical_and.reduce(masks) if masks else np.ones(len(stamps_ns), dtype=bool)

    def at(self, target: str, source: str, stamp_ns: int) -> se3.Matrix4:
        """T_target_source of two linked frames at a covered time, interpolated. Raises BadField."""
        meeting = self._meeting(target, source)
        if meeting is None:
            raise BadField(f"no transform between the frames {target} and {source}", field="frame")
        return se3.inverse(self._up(target, meeting, stamp_ns)) @ self._up(source, meeting, stamp_ns)

    def stamps_ns(self, target: str, source: str) -> list[Stamps]:
        """The times of each transform that moves between two linked frames, in the order of the bag."""
        return [edge.stamps_ns for edge in self._way(target, source) if edge.moves]

    def _meeting(self, target: str, source: str) -> str | None:
        """The lowest frame that both lie in."""
        above = [target, *self.ancestors(target)]
        return next((frame for frame in (source, *self.ancestors(source)) if frame in above), None)

    def _edges_up(self, frame: str, ancestor: str) -> list[_Edge]:
        edges = []
        while frame != ancestor:
            edges.append(self._edges[frame])
            frame = edges[-1].parent
        return edges

    def _way(self, target: str, source: str) -> list[_Edge]:
        meeting = self._meeting(target, source)
        return [] if meeting is None else self._edges_up(target, meeting) + self._edges_up(source, meeting)

    def _up(self, frame: str, ancestor: str, stamp_ns: int) -> se3.Matrix4:
        """T_ancestor_frame."""
        steps = [edge.at(stamp_ns) for edge in self._edges_up(frame, ancestor)]
        return reduce(lambda T_frame, T_parent: T_parent @ T_frame, steps, np.eye(4))


def stamped_poses(transforms: Iterable[StampedTransform]) -> StampedPoses:
    """The poses by rising time; of several with one time the first."""
    samples = list(transforms)
    stamps, first = np.unique(np.array([sample.stamp_ns for sample in samples], dtype=np.int64), return_index=True)
    return StampedPoses(stamps, np.stack([samples[index].T_parent_child for index in first]))


def _edge(samples: list[StampedTransform], moves: bool) -> _Edge:
    parent = samples[0].parent
    kept = [sample for sample in samples if sample.parent == parent]
    stamps = np.array([sample.stamp_ns for sample in kept], dtype=np.int64)
    if moves and len(np.unique(stamps)) > 1:
        return _Edge(parent, stamped_poses(kept), True, stamps)
    # As in ROS, the last static transform holds, whatever its stamp.
    return _Edge(parent, stamped_poses(kept[-1:]), False, stamps[-1:])

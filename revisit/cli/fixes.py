"""Fixes of satellites in a recording as anchors of its session."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.cli.output import refuse
from revisit.sdk.anchors import FixSpacing, NewAnchor

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.evaluation.datasets.posed_clouds import StampedPoses
    from revisit.formats.satellite_fix import SatelliteFix


def anchors_of(recording: Recording, topic: str | None, antenna_m: tuple[float, float, float]) -> list[NewAnchor]:
    """The fixes of a recording on its drive; those of `topic`, or of the one with most. Exits where there is no such
    topic. `antenna_m` is the antenna in the frame of the sensor.
    """
    from revisit.evaluation.datasets.posed_clouds import StampedPoses

    fixes: Mapping[str, Sequence[SatelliteFix]] = getattr(recording, "fixes", {})
    if topic is not None and topic not in fixes:
        raise refuse(f"{recording.name} has no fixes of satellites on {topic}: it has {', '.join(fixes) or 'none'}")
    chosen = topic or max(sorted(fixes), key=lambda name: len(fixes[name]), default=None)
    if chosen is None or not len(recording):
        return []
    poses = np.stack([recording.pose(index) for index in range(len(recording))])
    order = np.unique(recording.stamps_ns, return_index=True)[1]
    drive, spacing = StampedPoses(recording.stamps_ns[order], poses[order]), FixSpacing()
    on_drive = _on_drive(_usable(fixes[chosen]), drive)
    return [NewAnchor.of_fix(fix, T, antenna_m) for fix, T in on_drive if spacing.takes(T)]


def _usable(fixes: Sequence[SatelliteFix]) -> list[SatelliteFix]:
    """The fixes that tell a place, by rising time."""
    by_stamp = {one.stamp_ns: one for one in fixes if one.is_place}
    return [by_stamp[stamp] for stamp in sorted(by_stamp)]


def _on_drive(fixes: Sequence[SatelliteFix], drive: StampedPoses) -> Iterator[tuple[SatelliteFix, NDArray[np.float64]]]:
    """Fixes on the drive with the pose of the sensor."""
    covered = drive.covered(np.array([one.stamp_ns for one in fixes], dtype=np.int64))
    for fix, is_covered in zip(fixes, covered, strict=True):
        if is_covered:
            yield fix, drive.at(fix.stamp_ns)

"""Where an ingest goes on: behind which scan of a recording, and whether a session holds that recording at all."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from revisit.core.config import SubmapConfig
from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.core.point_columns import only
from revisit.core.scan_marks import ScanMarks, marked_rows, way_along
from revisit.evaluation.datasets import name_of_scan
from revisit.formats import NPY, decode_cloud
from revisit.sdk.clouds import PointCloud, PointsLike
from revisit.sdk.errors import AlreadyExists, ApiError, ErrorDetails, FailedPrecondition

if TYPE_CHECKING:
    from revisit.core.geometry.se3 import Matrix4
    from revisit.core.scan import Scan
    from revisit.evaluation.datasets import Recording
    from revisit.sdk.client import Client
    from revisit.sdk.resources import Session, Submap

SAME_POSE = 1e-6
"""Numbers of a pose that differ by less, metres or none, are the same number in another notation."""

SAME_LENGTH_SHARE = 1e-6
"""Lengths of a path that differ by less than this share of it were added up in another order."""

SAME_POINT_M = 0.005
"""Clouds are sent to the millimetre, and stored as float32."""

POINTS_COMPARED = 200
"""So many points of a submap are looked for, evenly spread."""


def readable_or_error(recording: Recording, index: int) -> Scan | RevisitError:
    """The scan with that index, or why it cannot be read: it is damaged or empty."""
    try:
        return recording.scan(index)
    except RevisitError as error:
        return error


def sent_points(scan: Scan, columns: Collection[str]) -> PointsLike:
    """The points as they are sent: with those of the columns that they have."""
    told = only(scan.columns, columns)
    return PointCloud(scan.points, told) if told else scan.points


def first_unsent(
    client: Client, session: Session, recording: Recording, spooled_ns: int | None = None, columns: Collection[str] = ()
) -> int:
    """The index of the first scan behind the last one that an unfinished session, or its spool, was given.

    `spooled_ns` is the time of the last scan that was put into the spool: the service may have refused that one. Raises
    AlreadyExists where the session ends with a scan of another recording.
    """
    unsent = 0 if session.committed_stamp_ns is None else _last_held(client, session, recording, columns) + 1
    if spooled_ns is None or spooled_ns <= (session.committed_stamp_ns or 0):
        return unsent
    refused = np.flatnonzero(recording.stamps_ns[unsent:] == spooled_ns)
    return unsent + int(refused[0]) + 1 if len(refused) else unsent


def _last_held(client: Client, session: Session, recording: Recording, columns: Collection[str]) -> int:
    """The last stored scan. Of scans with the same time the service says which one it has. Raises AlreadyExists."""
    for index in _at_last_stamp(session, recording):
        scan = readable_or_error(recording, index)
        if isinstance(scan, RevisitError):
            continue
        points = sent_points(scan, columns)
        if client.holds_scan(session, session.committed_seq, points, scan.T_odom_sensor, scan.stamp_ns):
            return index
    message = (
        f"{session.name} ends with a scan that {recording.name} does not have at its position (scan "
        f"{session.committed_seq}, stamp {session.committed_stamp_ns} ns). Another recording, or this one read with "
        "other options? Give this one a session of its own, with --session NAME"
    )
    raise AlreadyExists(ErrorDetails("ALREADY_EXISTS", "ALREADY_EXISTS", message))


def require_stored(client: Client, session: Session, recording: Recording, count: int) -> None:
    """Raises FailedPrecondition unless a finished session holds all of the first `count` scans that can be read."""
    marks = _marks_of(client, session)
    last = _last_stored(client, session, recording, marks)
    if last is None:
        lacking = f"it does not hold this recording ({recording.name}), or not as it is read now"
    else:
        lacking = _lacking(session, recording, last, count, marks)
    if not lacking:
        return
    message = (
        f"{session.name} is finished and takes no more scans, and {lacking}. Give the recording a session of its own, "
        f"with --session NAME, or delete that one (`revisit delete {session.name}`, or DELETE /v1/{session.name}) and "
        "ingest again"
    )
    raise FailedPrecondition(ErrorDetails("FAILED_PRECONDITION", "SESSION_FINISHED", message))


def _marks_of(client: Client, session: Session) -> ScanMarks:
    """The marks of a session's map, as services have them where nobody has set them otherwise."""
    tau_m = client.get_map(session.name.partition("/sessions/")[0]).tau_m
    return ScanMarks.of(replace(SubmapConfig(), tau=tau_m))


def _at_last_stamp(session: Session, recording: Recording) -> list[int]:
    """The scans that have the time of the last stored one, and can have its number.

    Their place is that of its number, or later where scans before it were left out.
    """
    at_stamp = np.flatnonzero(recording.stamps_ns == session.committed_stamp_ns)
    return [int(index) for index in at_stamp if index >= session.committed_seq - 1]


def _last_stored(client: Client, session: Session, recording: Recording, marks: ScanMarks) -> int | None:
    """The scan that a finished session ends with, -1 where it is empty; None where it is of another recording."""
    if session.committed_stamp_ns is None:
        return -1
    cut = [submap for submap in client.list_submaps(session) if submap.first_seq is not None]
    if not all(has_place(recording, submap) for submap in cut):
        return None
    for last in _at_last_stamp(session, recording):
        if _is_as_long(session, recording, last, marks) and _has_its_points(client, cut, recording, last):
            return last
    return None


def has_place(recording: Recording, submap: Submap) -> bool:
    """Whether a scan was taken where and when the middle scan of the submap was."""
    at_stamp = np.flatnonzero(recording.stamps_ns == submap.stamp_ns)
    return any(np.abs(recording.pose(int(index)) - submap.T_odom_submap).max() < SAME_POSE for index in at_stamp)


def _is_as_long(session: Session, recording: Recording, last: int, marks: ScanMarks) -> bool:
    """Whether the path up to the scan `last` is the session's; at most as long where scans were left out.

    Services and robots of before counted every pose, so that its length lies between the two.
    """
    poses = [recording.pose(index) for index in range(last + 1)]
    ways = [way_along(poses, of) for of in (marks, replace(marks, least_step_m=0.0))]
    least_m, most_m = (0.0 if way is None else way.travelled_m for way in ways)
    tolerance_m = SAME_POSE + SAME_LENGTH_SHARE * most_m
    long_enough = last >= session.committed_seq or session.travelled_m > least_m - tolerance_m
    return long_enough and session.travelled_m < most_m + tolerance_m


def _has_its_points(client: Client, cut: list[Submap], recording: Recording, last: int) -> bool:
    """Whether scans up to the last one saw points of the last submap; taken for true where that cannot be had."""
    if not cut:
        return True
    try:
        points = decode_cloud(client.download(cut[-1], "npy"), NPY).points
    except ApiError as error:
        if error.retryable:
            raise
        return True
    unseen = se3.apply(cut[-1].T_odom_submap, points[:: -(-len(points) // POINTS_COMPARED)].astype(np.float64))
    for index in range(last, -1, -1):
        scan = readable_or_error(recording, index)
        if not isinstance(scan, RevisitError):
            apart_m, _ = cKDTree(scan.points).query(se3.apply(se3.inverse(scan.T_odom_sensor), unseen))
            unseen = unseen[apart_m > SAME_POINT_M]
        if len(unseen) == 0:
            return True
    return False


def _lacking(session: Session, recording: Recording, last: int, count: int, marks: ScanMarks) -> str:
    """The part of the recording that a session ending with the scan `last` lacks; empty for nothing.

    It holds all scans, or those alone that descriptions are made of.
    """
    stored = session.committed_seq
    if last + 1 == stored == count:
        return ""
    described = _described(recording, count, marks)
    expected = sum(index <= last for index in described)
    if stored < expected:
        return f"it holds {stored} of the {expected} scans of {recording.name} that are described up to its last one"
    for index in described[expected:]:
        return f"it ends before {name_of_scan(recording, index)} of {recording.name}"
    return ""


def _described(recording: Recording, count: int, marks: ScanMarks) -> list[int]:
    """Those of the first `count` scans of a recording that descriptions are made of.

    Damaged ones are left out, and such as lie before an earlier one: time must not go backwards in a session.
    """
    stamps = recording.stamps_ns[:count]
    usable: list[tuple[int, Matrix4, int]] = []
    for index in np.flatnonzero(stamps == np.maximum.accumulate(stamps)):
        scan = readable_or_error(recording, int(index))
        if not isinstance(scan, RevisitError):
            usable.append((int(index), scan.T_odom_sensor, len(scan.points)))
    rows = marked_rows(((pose, returns) for _, pose, returns in usable), marks)
    return [usable[row][0] for row in rows]

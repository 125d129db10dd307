"""Submaps and operations as clients see them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.records import JobRecord, SubmapRecord
from revisit.service.domain.states import OperationKind, OperationState, SubmapState
from revisit.service.features.graph.map_frames import MapPose
from revisit.service.ports.repositories import FoundSubmap


@dataclass(frozen=True)
class OperationFailure:
    """Why an operation failed: an ErrorCode and a sentence."""

    code: str
    message: str


@dataclass(frozen=True)
class OperationProgress:
    """How far a run has come: `done` of `total` parts of a stage."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class OperationView:
    """An operation as clients see it. `subject` is a resource name (a submap or a map); `result` is JSON, once DONE.

    `progress` is there while it runs, where its kind tells; `cancel_requested` says that it is asked to end.
    """

    operation_id: str
    kind: OperationKind
    state: OperationState
    subject: str
    attempts: int
    result: dict[str, Any] | None
    failure: OperationFailure | None
    created_at_ns: int
    finished_at_ns: int | None
    progress: OperationProgress | None = None
    cancel_requested: bool = False

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in (OperationState.DONE, OperationState.FAILED)


@dataclass(frozen=True)
class SubmapView:
    """A submap as clients see it.

    `ordinal` counts the submaps of its session from 0; `position_m` is where it was taken, in the session's odometry
    frame; `first_seq`..`last_seq` are its scans (None for a posted cloud); `raw_bytes` is the float32 xyz cloud's
    size, `neural_map_bytes` that of its neural map; `failure` says why it could not be described. `descriptor` (d,) is
    there where it was asked for and the submap is described. `seq` grows with every submap of the service, in the order
    of their commits: a query's `min_seq` (see `freshness`). `in_map` is T_map_submap where its session has a frame.
    """

    key: SubmapKey
    seq: int
    state: SubmapState
    ordinal: int
    T_odom_submap: Matrix4
    position_m: tuple[float, float, float]
    stamp_ns: int
    first_seq: int | None
    last_seq: int | None
    scan_count: int
    point_count: int
    raw_bytes: int
    neural_map_bytes: int | None
    flags: tuple[str, ...]
    model_version: str | None
    failure: OperationFailure | None
    operation_id: str
    created_at_ns: int
    descriptor: NDArray[np.float32] | None = field(default=None, compare=False)
    in_map: MapPose | None = None


@dataclass(frozen=True)
class PostedOperation:
    """An operation that was asked for, and whether the same one waited already."""

    operation: OperationView
    replay: bool


def operation_view(record: JobRecord) -> OperationView:
    """The client's view of a job."""
    return OperationView(
        operation_id=record.operation_id,
        kind=OperationKind(record.kind),
        state=OperationState(record.state),
        subject=record.subject,
        attempts=record.attempts,
        result=record.result,
        failure=failure_of(record.failure_code, record.failure_message),
        created_at_ns=record.created_at_ns,
        finished_at_ns=record.finished_at_ns,
        progress=_progress(record),
        cancel_requested=record.cancel_requested,
    )


def _progress(record: JobRecord) -> OperationProgress | None:
    """Of a running job; the last report of an ended one is no news."""
    shown = record.progress is not None and record.state == OperationState.RUNNING
    return OperationProgress(**record.progress) if shown and record.progress is not None else None


def failure_of(code: str | None, message: str | None) -> OperationFailure | None:
    """The failure that a row holds, if any."""
    return None if code is None else OperationFailure(code, message or "")


def submap_key(record: SubmapRecord | FoundSubmap) -> SubmapKey:
    """The key of a submap's row."""
    return SubmapKey(record.map_id, record.session_id, record.submap_id)


def submap_view(record: SubmapRecord, in_map: MapPose | None = None) -> SubmapView:
    """The client's view of a submap."""
    return SubmapView(
        key=submap_key(record),
        seq=record.number,
        state=SubmapState(record.state),
        ordinal=record.ordinal,
        T_odom_submap=pose_matrix(record.T_odom_submap),
        position_m=record.position_m,
        stamp_ns=record.stamp_ns,
        first_seq=record.first_seq,
        last_seq=record.last_seq,
        scan_count=record.scan_count,
        point_count=record.point_count,
        raw_bytes=12 * record.point_count,
        neural_map_bytes=record.neural_map_bytes,
        flags=record.flags,
        model_version=record.model_version,
        failure=failure_of(record.failure_code, record.failure_message),
        operation_id=record.operation_id,
        created_at_ns=record.created_at_ns,
        in_map=in_map,
    )

"""Answers of the service that are not their messages field by field; all others are made from these (`resources`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.sdk.reading import Json, Matrix4, Read, Resource, matrix, read_by, vector_of


def in_map(pose: str) -> Read:
    """A pose in the map: the transform in the field `pose`, with its frame and version."""

    def read(message: Any) -> MapPose | None:
        if not message.HasField(pose):
            return None
        return MapPose(matrix(getattr(message, pose)), message.frame, message.map_version)

    return read


def _pairs(message: Any) -> NDArray[np.int64]:
    return np.array([(pair.query, pair.match) for pair in message.pairs], dtype=np.int64).reshape(-1, 2)


def _agreements(message: Any) -> NDArray[np.bool_]:
    return np.array([pair.agrees for pair in message.pairs], dtype=bool)


def _distances(name: str) -> Read:
    """Numbers (n,), NaN where one is absent."""
    return lambda message: np.array(
        [getattr(one, name) if one.HasField(name) else np.nan for one in message.distances], dtype=np.float64
    )


def _rows(name: str) -> Read:
    """Points or directions (n, 3)."""
    return lambda message: np.array(
        [vector_of(getattr(one, name)) for one in message.points], dtype=np.float64
    ).reshape(-1, 3)


@dataclass(frozen=True)
class MapPose:
    """A pose (4, 4) in a frame of the map, by a version of the map; poses of different frames cannot be compared."""

    T_map: Matrix4 = field(compare=False)
    frame: str
    map_version: int


@dataclass(frozen=True)
class OperationProgress(Resource):
    """How far an operation has come: `done` of `total` parts of a stage."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class Operation(Resource):
    """Work that goes on after the answer; `result` once DONE, `failure_reason` once FAILED.

    `seq` is that of the submap, where `post_submap` returned the operation: the `min_seq` of a query that must see it.
    `progress` is there while it optimises or merges maps; `cancel_requested` says that it is asked to end.
    """

    name: str
    kind: str
    state: str
    subject: str
    attempts: int
    result: Json | None
    failure_reason: str | None = field(metadata=read_by(lambda message: message.failure.reason or None))
    failure_message: str | None = field(metadata=read_by(lambda message: message.failure.message or None))
    seq: int | None = field(default=None, compare=False, metadata=read_by(lambda _message: None))
    progress: OperationProgress | None = field(default=None, compare=False)
    cancel_requested: bool = field(default=False, compare=False)

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in ("DONE", "FAILED")


@dataclass(frozen=True)
class KeypointPlan(Resource):
    """The keypoints (n, 2) of a submap, metres in its upright frame; T_submap_level (4, 4) is where that lies."""

    submap: str
    T_submap_level: Matrix4 = field(compare=False)
    keypoints: NDArray[np.float64] = field(
        compare=False, metadata=read_by(lambda plan: np.stack([plan.x, plan.y], axis=1))
    )


@dataclass(frozen=True)
class LoopKeypoints(Resource):
    """The compared keypoints of a loop closure: both submaps from above.

    pairs (p, 2): rows of the keypoints of query and match that look alike, the most alike first; agrees (p,): whether
    the pose of the loop closure brings them together.
    """

    query: KeypointPlan
    match: KeypointPlan
    pairs: NDArray[np.int64] = field(compare=False, metadata=read_by(_pairs))
    agrees: NDArray[np.bool_] = field(compare=False, metadata=read_by(_agreements))


@dataclass(frozen=True)
class MapTile(Resource):
    """A square of a version of a map, in metres of the frame seen from above; `submaps` may reach into it.

    One that was `made` can be downloaded at once; others are made by a worker then.
    """

    name: str
    frame: str
    min_m: tuple[float, float] = field(metadata=read_by(lambda message: (message.min_x_m, message.min_y_m)))
    max_m: tuple[float, float] = field(metadata=read_by(lambda message: (message.max_x_m, message.max_y_m)))
    submaps: int
    made: bool


@dataclass(frozen=True)
class MapDistances(Resource):
    """Signed distances (n,) of points to the surface of a map, metres, positive in free space, cut at a truncation.

    `nearest_m` (n,) says how far the nearest neural point is. Both are NaN where nothing was seen near.
    """

    map_version: int
    frame: str
    distance_m: NDArray[np.float64] = field(compare=False, metadata=read_by(_distances("distance_m")))
    nearest_m: NDArray[np.float64] = field(compare=False, metadata=read_by(_distances("nearest_m")))


@dataclass(frozen=True)
class MapPoints(Resource):
    """Points (n, 3) of the surface of a map around one, with unit normals (n, 3), the nearest first; `total` in all."""

    map_version: int
    frame: str
    positions: NDArray[np.float64] = field(compare=False, metadata=read_by(_rows("position_m")))
    normals: NDArray[np.float64] = field(compare=False, metadata=read_by(_rows("normal")))
    total: int


@dataclass(frozen=True)
class Webhook(Resource):
    """Where events are sent; `secret` is there in the answer that created it, and nowhere else.

    `told` is the number of the last event that arrived, within its map, `failures` counts attempts in vain since then;
    `state` ENABLED or SUSPENDED.
    """

    name: str
    url: str
    map: str | None
    kinds: tuple[str, ...]
    state: str
    told: int
    failures: int
    secret: str = field(default="", compare=False, repr=False, metadata=read_by(lambda _message: ""))


@dataclass(frozen=True)
class Status(Resource):
    """The state of the service. `grpc_address`: where clients reach gRPC, :PORT on the host of the HTTP side."""

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: tuple[str, ...] = field(
        metadata=read_by(lambda message: tuple(worker.worker_id for worker in message.workers))
    )
    grpc_address: str = ""

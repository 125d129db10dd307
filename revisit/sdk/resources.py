"""What the service answers, as frozen dataclasses; both transports give the same ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3

Json = dict[str, Any]
Matrix4 = NDArray[np.float64]


def pose_json(T_target_source: Any) -> Json:
    """A (4, 4) or (3, 4) transform as JSON. Raises core.errors.BadTransform."""
    transform = se3.validated(T_target_source)
    translation = dict(zip("xyz", (float(v) for v in transform[:3, 3]), strict=True))
    rotation = dict(zip("xyzw", (float(v) for v in se3.to_quaternion(transform)), strict=True))
    return {"translation": translation, "rotation": rotation}


def matrix_of(value: Json | None) -> Matrix4 | None:
    """A transform of an answer as (4, 4), None where there is none."""
    if not value:
        return None
    rotation, translation = value.get("rotation") or {}, value.get("translation") or {}
    quaternion = [float(rotation.get(axis, 0.0)) for axis in "xyzw"]
    return se3.from_quaternion(quaternion, _vector(translation))


@dataclass(frozen=True)
class Map:
    """A map; `scene_scale` is the size of its scene compared with a street."""

    name: str
    display_name: str
    tau_m: float
    stride_m: float
    min_index_gap: int
    scene_scale: float
    session_count: int
    submap_count: int
    created_at_ns: int

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(
            name=value["name"],
            display_name=value["display_name"],
            tau_m=float(value["tau_m"]),
            stride_m=float(value["stride_m"]),
            min_index_gap=int(value["min_index_gap"]),
            scene_scale=float(value["scene_scale"]),
            session_count=int(value["session_count"]),
            submap_count=int(value["submap_count"]),
            created_at_ns=int(value["created_at_ns"]),
        )


@dataclass(frozen=True)
class Robot:
    """A robot."""

    name: str
    display_name: str
    created_at_ns: int

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(value["name"], value["display_name"], int(value["created_at_ns"]))


@dataclass(frozen=True)
class Session:
    """A session; `committed_seq` is the last scan that is stored durably, 0 for none, taken at `committed_stamp_ns`."""

    name: str
    robot: str | None
    state: str
    committed_seq: int
    travelled_m: float
    submap_count: int
    created_at_ns: int
    finished_at_ns: int | None
    committed_stamp_ns: int | None

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(
            name=value["name"],
            robot=value.get("robot") or None,
            state=_state(value["state"]),
            committed_seq=int(value["committed_seq"]),
            travelled_m=float(value["travelled_m"]),
            submap_count=int(value["submap_count"]),
            created_at_ns=int(value["created_at_ns"]),
            finished_at_ns=_int_or_none(value.get("finished_at_ns")),
            committed_stamp_ns=_int_or_none(value.get("committed_stamp_ns")),
        )


@dataclass(frozen=True)
class Operation:
    """Work that goes on after the answer; `result` once DONE, `failure_reason` once FAILED.

    `seq` is that of the submap, where `post_submap` returned the operation: the `min_seq` of a query that must see it.
    """

    name: str
    kind: str
    state: str
    subject: str
    attempts: int
    result: Json | None
    failure_reason: str | None
    failure_message: str | None
    seq: int | None = field(default=None, compare=False)

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in ("DONE", "FAILED")

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        failure = value.get("failure") or {}
        return cls(
            name=value["name"],
            kind=value["kind"].removeprefix("OPERATION_KIND_"),
            state=_state(value["state"]),
            subject=value["subject"],
            attempts=int(value["attempts"]),
            result=value.get("result"),
            failure_reason=failure.get("reason"),
            failure_message=failure.get("message"),
        )


@dataclass(frozen=True)
class Submap:
    """A submap; sizes in bytes, the position in the session's odometry frame.

    `descriptor` is there where the full view was asked for and the submap is described. `seq` grows with every submap
    of the service: a query with it as `min_seq` sees this submap.
    """

    name: str
    state: str
    ordinal: int
    T_odom_submap: Matrix4 = field(compare=False)
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
    operation: str
    descriptor: tuple[float, ...] = ()
    seq: int = 0

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        pose = matrix_of(value["t_odom_submap"])
        if pose is None:
            raise ValueError(f"the answer has no pose of submap {value['name']}")
        return cls(
            name=value["name"],
            state=_state(value["state"]),
            ordinal=int(value["ordinal"]),
            T_odom_submap=pose,
            position_m=_vector(value["position_m"]),
            stamp_ns=int(value["stamp_ns"]),
            first_seq=_int_or_none(value.get("first_seq")),
            last_seq=_int_or_none(value.get("last_seq")),
            scan_count=int(value["scan_count"]),
            point_count=int(value["point_count"]),
            raw_bytes=int(value["raw_bytes"]),
            neural_map_bytes=_int_or_none(value.get("neural_map_bytes")),
            flags=tuple(value["flags"]),
            model_version=value.get("model_version") or None,
            operation=value["operation"],
            descriptor=tuple(float(number) for number in value.get("descriptor", ())),
            seq=int(value["seq"]),
        )


@dataclass(frozen=True)
class SearchHit:
    """A submap and its cosine similarity to the query."""

    submap: str
    similarity: float
    position_m: tuple[float, float, float]

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(value["submap"], float(value["similarity"]), _vector(value["position_m"]))


@dataclass(frozen=True)
class Candidate:
    """A submap that was compared with a cloud: accepted with a transform, or rejected for a reason."""

    submap: str
    accepted: bool
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None = field(compare=False)
    evidence: Json

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(
            submap=value["submap"],
            accepted=bool(value["accepted"]),
            reason=value.get("reason") or None,
            similarity=float(value["similarity"]),
            score=float(value["score"]),
            T_match_query=matrix_of(value.get("t_match_query")),
            evidence=value.get("evidence") or {},
        )


@dataclass(frozen=True)
class Localization:
    """The best verified candidate, None where the place is unknown, and all that were compared."""

    best: Candidate | None
    T_map_query: Matrix4 | None = field(compare=False)
    candidates: tuple[Candidate, ...]

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        best = value.get("best")
        return cls(
            best=Candidate.parse(best) if best else None,
            T_map_query=matrix_of(value.get("t_map_query")),
            candidates=tuple(Candidate.parse(candidate) for candidate in value["candidates"]),
        )


@dataclass(frozen=True)
class LoopClosure:
    """A pair of submaps that look alike, with the verdict; `T_match_query` maps query-frame points to match-frame."""

    name: str
    number: int
    query: str
    match: str
    state: str
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None = field(compare=False)
    evidence: Json
    created_at_ns: int

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(
            name=value["name"],
            number=int(value["number"]),
            query=value["query"],
            match=value["match"],
            state=_state(value["state"]),
            reason=value.get("reason") or None,
            similarity=float(value["similarity"]),
            score=float(value["score"]),
            T_match_query=matrix_of(value.get("t_match_query")),
            evidence=value.get("evidence") or {},
            created_at_ns=int(value["created_at_ns"]),
        )


@dataclass(frozen=True)
class Status:
    """What the service is doing."""

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: tuple[str, ...]

    @classmethod
    def parse(cls, value: Json) -> Self:
        """From an answer."""
        return cls(
            version=value["version"],
            model_version=value.get("model_version") or None,
            queued_jobs=int(value["queued_jobs"]),
            running_jobs=int(value["running_jobs"]),
            failed_jobs=int(value["failed_jobs"]),
            indexed_submaps=int(value["indexed_submaps"]),
            workers=tuple(worker["worker_id"] for worker in value["workers"]),
        )


def _state(value: str) -> str:
    return value.rpartition("STATE_")[2]


def _int_or_none(value: Any) -> int | None:
    return None if value is None else int(value)


def _vector(value: Json) -> tuple[float, float, float]:
    return (float(value.get("x", 0.0)), float(value.get("y", 0.0)), float(value.get("z", 0.0)))

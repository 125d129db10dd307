"""Submaps: what a robot saw over a few metres of travel; posted as one cloud, or cut from a stream of scans."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from core.scan import CloudReport
from core.se3 import Matrix4
from service.application.clouds import CloudInput
from service.application.identity import SessionKey, SubmapKey, TenantId
from service.application.operations import OperationFailure, OperationView
from service.application.paging import Page, PageRequest


class SubmapState(StrEnum):
    """How far a submap has come."""

    QUEUED = "QUEUED"
    DESCRIBED = "DESCRIBED"
    FAILED = "FAILED"


class DownloadKind(StrEnum):
    """What of a submap can be downloaded."""

    MESH = "mesh"
    POINTS = "points"
    NEURAL = "neural"
    DESCRIPTOR = "descriptor"


@dataclass(frozen=True)
class PostSubmap:
    """One cloud in its sensor frame, seen from `T_odom_submap` (4, 4) in the session's odometry frame."""

    key: SubmapKey
    T_odom_submap: Matrix4
    stamp_ns: int
    cloud: CloudInput


@dataclass(frozen=True)
class SubmapView:
    """A submap as clients see it.

    `ordinal` counts the submaps of its session from 0; `position_m` is where it was taken, in the session's odometry
    frame; `first_seq`..`last_seq` are its scans (None for a posted cloud); `raw_bytes` is the float32 xyz cloud's
    size, `neural_map_bytes` that of its neural map; `failure` says why it could not be described.
    """

    key: SubmapKey
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


@dataclass(frozen=True)
class PostedSubmap:
    """A durable submap and the operation that describes it. `report` is None on a replay."""

    submap: SubmapView
    operation: OperationView
    replay: bool
    report: CloudReport | None


@dataclass(frozen=True)
class Download:
    """A file: its bytes, media type and a name to save it under."""

    data: bytes
    media_type: str
    filename: str


class Submaps(Protocol):
    """Post, get, list, delete and download submaps."""

    async def post(self, tenant: TenantId, command: PostSubmap) -> PostedSubmap:
        """Store a submap durably and queue its description; returns after the commit.

        Raises what decoding and validation raise, BadField, BadTransform, NotFound for the session, SessionFinished,
        AlreadyExists for other content under the same id, WorkersBusy, Draining, StorageFull, StorageUncertain.
        """
        ...

    async def get(self, tenant: TenantId, key: SubmapKey) -> SubmapView:
        """Raises NotFound."""
        ...

    async def list(self, tenant: TenantId, session: SessionKey, page: PageRequest) -> Page[SubmapView]:
        """The submaps of a session in their order. Raises NotFound for the session."""
        ...

    async def delete(self, tenant: TenantId, key: SubmapKey) -> None:
        """Delete a submap, its loop closures and its place in the index. Raises NotFound."""
        ...

    async def download(
        self, tenant: TenantId, key: SubmapKey, kind: DownloadKind, file_format: str | None = None
    ) -> Download:
        """The submap as a file. Formats: mesh ply; points pcd or ply; neural and descriptor have one of their own.

        Raises NotFound; NotReady where it is not described yet; UnsupportedEncoding for another format; DataLoss.
        """
        ...

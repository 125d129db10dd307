"""Scans: a stream of posed sweeps that the service cuts into submaps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from core.scan import CloudReport
from core.se3 import Matrix4
from service.application.clouds import CloudInput
from service.application.identity import SessionKey, TenantId
from service.application.submaps import PostedSubmap


@dataclass(frozen=True)
class AppendScan:
    """The scan with client sequence number `seq` (1, 2, 3, ...), taken from `T_odom_sensor` (4, 4)."""

    session: SessionKey
    seq: int
    stamp_ns: int
    T_odom_sensor: Matrix4
    cloud: CloudInput


@dataclass(frozen=True)
class ScanAck:
    """The scan is durable. `committed_seq` is the last durable one; `submap` is the one that this scan completed.

    A scan at or below `committed_seq` is acknowledged and ignored (`replay`).
    """

    committed_seq: int
    replay: bool
    report: CloudReport | None
    submap: PostedSubmap | None


@dataclass(frozen=True)
class OpenedStream:
    """Where a client resumes: the next scan to send is `committed_seq + 1`."""

    session: SessionKey
    committed_seq: int


class Scans(Protocol):
    """Open a session's stream and append scans to it."""

    async def open(self, tenant: TenantId, session: SessionKey) -> OpenedStream:
        """Raises NotFound, SessionFinished, Draining."""
        ...

    async def append(self, tenant: TenantId, command: AppendScan) -> ScanAck:
        """Store one scan durably; returns after the commit.

        Raises what decoding and validation raise, NotFound, SessionFinished, SequenceGap(expected), WorkersBusy,
        Draining, StorageFull, StorageUncertain.
        """
        ...

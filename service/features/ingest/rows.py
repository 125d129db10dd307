"""Sources of a submap: one posted cloud, or the scans of a window; and their assembly."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from revisit.core.config import SubmapConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.core.scan import CloudReport, Scan
from revisit.core.scan_marks import ScanMarks, marked_rows
from revisit.core.submap import Submap
from revisit.service.domain.errors import NotKept
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import Pose, ScanRecord, SubmapRecord
from revisit.service.domain.retention import KeptScans
from revisit.service.features.ingest.clouds import unpack_cloud
from revisit.service.ports.blobs import CLOUD_BLOB, BlobStore
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

MAX_SCANS = 400
"""A window can hold any number of scans: at most this many, evenly spread, are used."""


@dataclass(frozen=True)
class PosedCloud:
    """A stored cloud and where it was taken from."""

    cloud_sha256: str
    T_odom_sensor: Pose
    stamp_ns: int
    point_count: int


@dataclass(frozen=True)
class SubmapSource:
    """The clouds of a submap in time order and the pose of its frame; `posted`: one, accumulated elsewhere."""

    clouds: tuple[PosedCloud, ...]
    posted: bool
    config: SubmapConfig
    T_odom_submap: Pose


def submap_source(uow: UnitOfWork, policy: Policy, record: SubmapRecord) -> SubmapSource:
    """The source of a stored submap; without clouds where retention has removed them."""
    config = policy.for_map(require_map(uow, record.tenant, record.map_id)).submap
    if record.kept_scans == KeptScans.NONE:
        return SubmapSource((), record.first_seq is None, config, record.T_odom_submap)
    if record.first_seq is None or record.last_seq is None:
        posted = PosedCloud(str(record.cloud_sha256), record.T_odom_submap, record.stamp_ns, record.point_count)
        return SubmapSource((posted,), posted=True, config=config, T_odom_submap=record.T_odom_submap)
    scans = described_scans(uow, record, config)
    clouds = tuple(PosedCloud(scan.cloud_sha256, scan.T_odom_sensor, scan.stamp_ns, scan.point_count) for scan in scans)
    return SubmapSource(clouds, posted=False, config=config, T_odom_submap=record.T_odom_submap)


def described_scans(uow: UnitOfWork, record: SubmapRecord, config: SubmapConfig) -> list[ScanRecord]:
    """The stored scans that a submap of a window is described from; none of a posted one, or where none is kept."""
    if record.first_seq is None or record.last_seq is None:
        return []
    session, window = SessionKey(record.map_id, record.session_id), (record.first_seq, record.last_seq)
    chosen = chosen_scans(uow, record.tenant, session, *window)
    if record.kept_scans == KeptScans.DESCRIBED or len(chosen) >= record.scan_count:
        return chosen
    return _marked_scans(uow, record.tenant, session, window, config)


def chosen_scans(uow: UnitOfWork, tenant: TenantId, session: SessionKey, first: int, last: int) -> list[ScanRecord]:
    """The scans that were chosen as they came, of the numbers first..last; at most MAX_SCANS, with both ends."""
    chosen = uow.scans.chosen_between(tenant, session.map_id, session.session_id, first, last)
    return [chosen[row] for row in spread_rows(0, len(chosen) - 1)] if chosen else []


def _marked_scans(
    uow: UnitOfWork, tenant: TenantId, session: SessionKey, window: tuple[int, int], config: SubmapConfig
) -> list[ScanRecord]:
    """The same of a window that was stored before scans were chosen as they came: the choice is made now."""
    scans = uow.scans.with_seqs(tenant, session.map_id, session.session_id, spread_rows(*window))
    poses = ((pose_matrix(scan.T_odom_sensor), scan.point_count) for scan in scans)
    return [scans[row] for row in marked_rows(poses, ScanMarks.of(config))]


def require_scans(record: SubmapRecord) -> None:
    """Raises NotKept where retention has removed the scans of a submap."""
    if record.kept_scans == KeptScans.NONE:
        raise NotKept(f"the scans of {record.submap_id} are not kept: its map's policy of retention removed them")


def spread_rows(first: int, last: int) -> list[int]:
    """The numbers first..last; of more than MAX_SCANS so many, evenly spread, with both ends."""
    if last - first < MAX_SCANS:
        return list(range(first, last + 1))
    return [first + round(index * (last - first) / (MAX_SCANS - 1)) for index in range(MAX_SCANS)]


def load_submap(blobs: BlobStore, record: SubmapRecord, source: SubmapSource, columns: Collection[str] = ()) -> Submap:
    """The submap with its points: its scans are read one by one, and take no room.

    It has those of the `columns` that all its scans have; descriptions need none. Raises DataLoss, EmptyCloud; NotKept
    where retention has removed them.
    """
    require_scans(record)
    scans = each_scan(blobs, record, source, columns)
    if source.posted:
        return Submap.from_cloud(next(scans), source.config)
    room = sum(cloud.point_count for cloud in source.clouds)
    return Submap.accumulated(scans, pose_matrix(source.T_odom_submap), source.config, room)


def each_scan(
    blobs: BlobStore, record: SubmapRecord, source: SubmapSource, columns: Collection[str] = ()
) -> Iterator[Scan]:
    """The scans that a submap is made of, or its one cloud, as they are asked for. Raises DataLoss."""
    for cloud in source.clouds:
        stored = unpack_cloud(blobs.get(record.tenant, CLOUD_BLOB, cloud.cloud_sha256), columns)
        yield Scan(
            stored.points,
            pose_matrix(cloud.T_odom_sensor),
            cloud.stamp_ns,
            CloudReport(0, "degenerate_plane" in record.flags),
            stored.columns,
        )

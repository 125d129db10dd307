"""Publishing a version of a map as a file, by a worker."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import IO, Any, cast

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.map_layout import LayoutRecorder, MapLayout
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.formats.map_file import FiledSubmap, MapDescription, write_map
from revisit.service.domain import limits
from revisit.service.domain.errors import NotReady
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import MapFileRecord, SubmapRecord
from revisit.service.domain.states import MapFileState, SubmapState
from revisit.service.failpoints import failpoint
from revisit.service.features.catalogue.maps import policy_in_force
from revisit.service.features.deletion.blob_references import forget_file
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.features.operations.unchanged import unchanged
from revisit.service.features.optimisation.calls import version_seen
from revisit.service.features.tiles.rows import submaps_numbered
from revisit.service.ports.blobs import MAP_LAYOUT_BLOB, NEURAL_MAP_BLOB
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.storage import require_descriptor, require_map
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class FilingPlan:
    """The content of a file: description, and the described submaps with descriptors (their bytes), in their order."""

    description: MapDescription
    sessions: tuple[str, ...]
    submaps: tuple[FiledSubmap, ...]
    descriptors: tuple[bytes, ...]

    def is_of(self, other: FilingPlan) -> bool:
        """Whether both are of the same content: poses come from a version, and its hash covers them."""
        named = [[(one.name, one.neural) for one in plan.submaps] for plan in (self, other)]
        return named[0] == named[1] and self.description == other.description


class MapFiling:
    """Runs the jobs that publish versions of maps; all calls block."""

    def __init__(self, context: JobContext) -> None:
        """Layouts are stored as blobs."""
        self._context = context

    def run(self, lease: Lease) -> None:
        """Compute and store the layout of the file's bytes. Raises NotFound, NotReady, DataLoss."""
        message = "the map was changed again and again while its file was made"
        unchanged(partial(self._ended, lease), message)

    def _ended(self, lease: Lease) -> bool:
        """One reading of the map: whether the job has ended by it."""
        payload, tenant = lease.job.payload, lease.job.tenant
        plan = self._context.transactions.read(partial(self._plan, tenant=tenant, payload=payload)).result()
        layout = self._layout(tenant, plan)
        map_hash = layout.hash_with(partial(self._context.blobs.get, tenant, NEURAL_MAP_BLOB))
        put = partial(self._context.blobs.put, tenant, MAP_LAYOUT_BLOB, layout.to_blob())
        stored = put()
        failpoint("publish.after_blob")
        record = self._record(tenant, payload, plan, map_hash, layout.size, stored)
        commit = partial(self._stored, lease=lease, plan=plan, record=record)
        return self._context.write_naming(commit, put)

    def _plan(self, uow: UnitOfWork, tenant: TenantId, payload: dict[str, Any]) -> FilingPlan:
        return read_filing(uow, self._context.policy, tenant, payload["map_id"], payload["version"])

    def _layout(self, tenant: TenantId, plan: FilingPlan) -> MapLayout:
        recorder = LayoutRecorder({one.neural for one in plan.submaps})
        write_map(cast("IO[bytes]", recorder), plan.description, self._contents(tenant, plan))
        return recorder.layout()

    def _contents(self, tenant: TenantId, plan: FilingPlan) -> Iterator[tuple[FiledSubmap, NDArray[np.float32], bytes]]:
        for one, descriptor in zip(plan.submaps, plan.descriptors, strict=True):
            vector = np.frombuffer(descriptor, dtype="<f4")
            yield one, vector, self._context.blobs.get(tenant, NEURAL_MAP_BLOB, one.neural)

    def _record(
        self, tenant: TenantId, payload: dict[str, Any], plan: FilingPlan, map_hash: str, size: int, layout: str
    ) -> MapFileRecord:
        return MapFileRecord(
            tenant=tenant,
            map_id=payload["map_id"],
            version=payload["version"],
            sha256=map_hash,
            size_bytes=size,
            layout_sha256=layout,
            sessions=plan.sessions,
            submaps=len(plan.submaps),
            state=MapFileState.DISABLED.value,
            description=payload["description"],
            created_at_ns=self._context.clock.wall_ns(),
        )

    def _stored(self, uow: UnitOfWork, lease: Lease, plan: FilingPlan, record: MapFileRecord) -> bool:
        """Store the row and end the job; False where a submap of the file has gone meanwhile."""
        tenant = record.tenant
        uow.maps.get(tenant, record.map_id, hold=True)
        uow.queue.require(lease)
        if not plan.is_of(self._plan(uow, tenant, lease.job.payload)):
            return False
        known = uow.map_files.get(tenant, record.map_id, record.version)
        if known is None:
            uow.blobs.refer(tenant, [(MAP_LAYOUT_BLOB, record.layout_sha256)])
            known = uow.map_files.add(record)
            _forget_oldest(uow, tenant, record.map_id)
        name = f"maps/{known.map_id}/files/{known.version}"
        result = {"map_file": name, "map_hash": known.sha256, "size_bytes": known.size_bytes}
        uow.queue.complete(lease, result)
        return True


def read_filing(uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, version: int) -> FilingPlan:
    """The content of a version's file. Raises NotFound; NotReady without described submaps; DataLoss."""
    record, seen = require_map(uow, tenant, map_id), version_seen(uow, tenant, map_id, version)
    rows = sorted(uow.session_poses.find(tenant, map_id=map_id, version=version), key=lambda row: row.session_number)
    filed: list[FiledSubmap] = []
    descriptors: list[bytes] = []
    model = ""
    for row in rows:
        packed = PackedSubmaps.of(row.submaps)
        known = submaps_numbered(uow, tenant, packed.numbers.tolist())
        for number, T_map_submap in zip(packed.numbers.tolist(), packed.T_map_submap, strict=True):
            one = known.get(number)
            if one is not None and one.state == SubmapState.DESCRIBED and one.neural_map_sha256 is not None:
                filed.append(_filed(one, row.frame, T_map_submap))
                descriptors.append(require_descriptor(one))
                model = model or one.model_version or ""
    if not filed:
        raise NotReady(f"no submap of version {version} of map {map_id!r} is described"[:200])
    config = policy.for_map(record)
    description = MapDescription(
        map_id=map_id,
        map_version=str(version),
        content_hash=seen.content_hash,
        created_at_ns=seen.created_at_ns,
        model_version=model,
        scene_scale=config.scene_scale,
        tau_m=config.submap.tau,
        stride_m=config.submap.stride,
        loop_policy=asdict(policy_in_force(config)),
    )
    return FilingPlan(description, tuple(row.session_id for row in rows), tuple(filed), tuple(descriptors))


def _filed(submap: SubmapRecord, frame: str, T_map_submap: Matrix4) -> FiledSubmap:
    return FiledSubmap(
        name=submap.key.name,
        ordinal=submap.ordinal,
        stamp_ns=submap.stamp_ns,
        frame=frame,
        T_map_submap=_as_sent(T_map_submap),
        T_odom_submap=_as_sent(pose_matrix(submap.T_odom_submap)),
        neural=str(submap.neural_map_sha256),
    )


def _as_sent(T: Matrix4) -> Matrix4:
    """A pose as a client gets it, with a quaternion for its rotation: every writer makes the same bytes."""
    return se3.from_quaternion(se3.to_quaternion(np.asarray(T)).tolist(), T[:3, 3].tolist())


def _forget_oldest(uow: UnitOfWork, tenant: TenantId, map_id: str) -> None:
    """Delete the oldest files of a map that are too many and not ENABLED."""
    disabled = uow.map_files.find(tenant, map_id=map_id, state=MapFileState.DISABLED.value)
    for row in disabled[: max(0, uow.map_files.count(tenant, map_id=map_id) - limits.MAP_FILES)]:
        forget_file(uow, row)

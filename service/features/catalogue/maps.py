"""Maps: the places a fleet shares; every session, submap and loop closure belongs to one."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from functools import partial

from revisit.core.config import PipelineConfig, Profile
from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId, content_hash, validated_id, validated_label
from revisit.service.domain.loop_policy import LoopPolicy
from revisit.service.domain.records import MapRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.deletion.erasure import Erasure
from revisit.service.features.deletion.rows import mark_map
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest
from revisit.service.ports.index import VectorIndex
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.ports.storage import require_deleted, require_map, require_same_content
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class CreateMap:
    """A new map. `tau_m`, `stride_m`, `leave_distance_m` and `loop_policy` override the service's settings where given.

    `scene_scale` is the size of its scene compared with a street, e.g. 0.25 for rooms; `profile` is a `Profile`, by
    which its submaps are described. Neither can be changed later.
    """

    map_id: str
    display_name: str = ""
    tau_m: float | None = None
    stride_m: float | None = None
    leave_distance_m: float | None = None
    scene_scale: float = 1.0
    loop_policy: LoopPolicy = LoopPolicy()
    profile: str = Profile.PRODUCT


@dataclass(frozen=True, kw_only=True)
class MapView(MapRecord):
    """A map; `tau_m`, `stride_m`, `leave_distance_m` and `loop_policy` are the values in force."""

    session_count: int
    submap_count: int
    loop_policy: LoopPolicy


@dataclass(frozen=True)
class CreatedMap:
    """The map, and whether an earlier identical request had created it."""

    map: MapView
    replay: bool


class Maps:
    """Create, get, list and delete maps."""

    def __init__(self, context: CallContext, erasure: Erasure, index: VectorIndex) -> None:
        """`index` forgets a deleted map, its `streams` end, and its rows and blobs go through `erasure`."""
        self._context = context
        self._erasure = erasure
        self._index = index

    async def create(self, tenant: TenantId, command: CreateMap) -> CreatedMap:
        """Create a map.

        Raises BadField; AlreadyExists where the id is taken by other content; StillDeleting where a map of this id was
        deleted and is not gone yet; Draining, RateLimited.
        """
        self._context.admission.charge_creation(tenant)
        record = self._record(tenant, command)
        return await self._context.storage.write(partial(self._add, record=record))

    def _add(self, uow: UnitOfWork, record: MapRecord) -> CreatedMap:
        known = uow.maps.get(record.tenant, record.map_id)
        if known is None:
            require_deleted(uow, record.tenant, record.map_id)
            return CreatedMap(self._view(uow, uow.maps.add(record)), replay=False)
        require_same_content(known.content_hash, record.content_hash, f"map {record.map_id}")
        return CreatedMap(self._view(uow, known), replay=True)

    async def get(self, tenant: TenantId, map_id: str) -> MapView:
        """Raises NotFound."""
        return await self._context.storage.read(lambda uow: self._view(uow, require_map(uow, tenant, map_id)))

    async def list(self, tenant: TenantId, page: PageRequest) -> Page[MapView]:
        """The tenant's maps, oldest first."""
        return await self._context.lists.page(
            tenant, page, lambda uow, after, limit: uow.maps.find(tenant, after=after, limit=limit), self._view
        )

    async def delete(self, tenant: TenantId, map_id: str) -> None:
        """Delete a map with everything in it, as `Sessions.delete` does. Raises NotFound, Draining."""
        self._context.admission.require_running()
        entry = audit.noted(tenant, "map_deleted", f"maps/{map_id}")
        work = partial(_delete, map_id=map_id, entry=entry, at_ns=self._context.clock.wall_ns())
        number = await self._context.storage.write(work)
        failpoint("delete.after_mark")
        self._index.drop(number)
        await self._erasure.soon(tenant, map_id)

    def _record(self, tenant: TenantId, command: CreateMap) -> MapRecord:
        validated_id(command.map_id, "map_id")
        validated_label(command.display_name, "display_name")
        _validate_window(command)
        content = (command.display_name, command.tau_m, command.stride_m, command.leave_distance_m)
        # Left out where they are the default, so that creates of before there were these fields can be repeated.
        scale = () if command.scene_scale == 1.0 else (command.scene_scale,)
        own = command.loop_policy
        policy = () if own == LoopPolicy() else ("loop_policy", *astuple(own))
        profile = () if command.profile == Profile.PRODUCT else ("profile", command.profile)
        return MapRecord(
            tenant=tenant,
            map_id=command.map_id,
            content_hash=content_hash((*content, *scale, *policy, *profile)),
            display_name=command.display_name,
            tau_m=command.tau_m,
            stride_m=command.stride_m,
            leave_distance_m=command.leave_distance_m,
            scene_scale=command.scene_scale,
            profile=command.profile,
            loop_candidates=own.candidates,
            min_score=own.min_score,
            min_overlap=own.min_overlap,
            max_seen_through=own.max_seen_through,
            model_version=None,
            created_at_ns=self._context.clock.wall_ns(),
        )

    def _view(self, uow: UnitOfWork, record: MapRecord) -> MapView:
        config = self._context.policy.for_map(record)
        in_force = {
            "tau_m": config.submap.tau,
            "stride_m": config.submap.stride,
            "leave_distance_m": config.loop.leave_distance,
        }
        return MapView(
            **{**vars(record), **in_force},
            session_count=uow.sessions.count(record.tenant, map_id=record.map_id),
            submap_count=uow.submaps.count(record.tenant, map_id=record.map_id),
            loop_policy=policy_in_force(config),
        )


def policy_in_force(config: PipelineConfig) -> LoopPolicy:
    """The rules for loops that these parameters hold."""
    rules = config.verification
    return LoopPolicy(config.loop.candidates, rules.min_score, rules.min_overlap, rules.max_seen_through)


def _delete(uow: UnitOfWork, map_id: str, entry: AuditEntry, at_ns: int) -> int:
    record = require_map(uow, TenantId(entry.tenant), map_id, hold=True)
    audit.append(uow, at_ns, entry)
    mark_map(uow, record, at_ns)
    return record.number


def model_for_map(record: MapRecord, recogniser: PlaceRecogniser) -> str:
    """The version of the descriptors that the models of a map's profile make for it.

    Its scale is part of it: descriptors of different scales must not be compared, like those of different models.
    """
    model_version, scale = recogniser.model_of(Profile(record.profile)), record.scene_scale
    return model_version if scale == 1.0 else f"{model_version}@scale-{scale:g}"


def _validate_window(command: CreateMap) -> None:
    if command.tau_m is not None:
        limits.TAU_M.validated(command.tau_m, "tau_m")
    if command.stride_m is not None:
        limits.STRIDE_M.validated(command.stride_m, "stride_m")
    if command.leave_distance_m is not None:
        limits.LEAVE_DISTANCE_M.validated(command.leave_distance_m, "leave_distance_m")
    limits.SCENE_SCALE.validated(command.scene_scale, "scene_scale")
    command.loop_policy.validated()
    if command.profile not in set(Profile):
        raise BadField(f"profile must be one of {', '.join(Profile)}, got {command.profile!r}", field="profile")

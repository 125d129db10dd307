"""Plans of a map: keep a picture, hold it by other pins, look at it, delete it.

The bytes of a picture are never decoded here: `formats.pictures` reads its size, and the browser shows it.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from revisit.core.errors import BadField, TooLarge
from revisit.formats.pictures import JPEG, PNG, Picture, PictureLimits, read_picture
from revisit.service.capacity.charged_work import ChargedWork
from revisit.service.capacity.limits import POINT_BYTES
from revisit.service.domain import limits
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId, content_hash, validated_detail, validated_id, validated_label
from revisit.service.domain.records import PlanRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.features.catalogue.downloads import Download, Room
from revisit.service.features.deletion.blob_references import blob_of_plan, forget_plan
from revisit.service.features.plans.rows import held_pins, plan_seen
from revisit.service.features.plans.rules import PlanPin, PlanView, two_pins
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, rows_of_map
from revisit.service.ports.blobs import PLAN_BLOB
from revisit.service.ports.storage import require_map, require_same_content
from revisit.service.ports.transactions import UnitOfWork

PICTURES = PictureLimits(limits.PLAN_MEGAPIXELS, int(limits.PLAN_SIDE.most))

EXTENSIONS = {PNG: "png", JPEG: "jpg"}


@dataclass(frozen=True)
class NewPlan:
    """A picture to keep: the bytes of its file, and two pins."""

    map_id: str
    plan_id: str
    image: bytes
    pins: Sequence[PlanPin]
    display_name: str = ""
    storey: str | None = None


@dataclass(frozen=True)
class CreatedPlan:
    """The plan, and whether an earlier identical request had created it."""

    plan: PlanView
    replay: bool


class Plans:
    """Create, get, list, pin, delete, download."""

    def __init__(self, context: CallContext, work: ChargedWork) -> None:
        """`work` has a turn for whoever sends a picture."""
        self._context = context
        self._work = work

    def precheck(self, tenant: TenantId) -> None:
        """The checks before a picture is read. Raises Draining, StorageFull, RateLimited."""
        self._context.admission.require_storage()
        self._context.admission.charge_call(tenant, 0)

    async def create(self, tenant: TenantId, new: NewPlan) -> CreatedPlan:
        """Keep a picture as a plan of a map; durable when answered.

        Raises NotFound; BadField; TooLarge, UnsupportedEncoding and MalformedBody for its bytes; AlreadyExists for
        other content under the same id; Draining, RateLimited, QuotaReached, StorageFull, StorageUncertain.
        """
        self._context.admission.require_storage()
        self._context.admission.charge_creation(tenant, len(new.image) // POINT_BYTES)
        row, pins = await self._work.of(tenant, partial(_row, tenant, new, self._context.clock.wall_ns()))
        known = await self._context.storage.read(partial(_replayed, row=row))
        if known is not None:
            return known
        await self._context.admission.require_room(tenant)
        put = partial(self._context.storage.blobs.put, tenant, PLAN_BLOB, new.image)
        await asyncio.to_thread(put)
        failpoint("plan.after_blob")
        entry = audit.noted(tenant, "plan_created", row.name)
        created = await self._context.storage.write_naming(partial(self._add, row=row, pins=pins, entry=entry), put)
        if not created.replay:
            self._context.admission.note_stored(tenant, row.size_bytes // POINT_BYTES)
        return created

    def _add(self, uow: UnitOfWork, row: PlanRecord, pins: Sequence[PlanPin], entry: AuditEntry) -> CreatedPlan:
        of_map = require_map(uow, row.tenant, row.map_id, hold=True)
        known = _replayed(uow, row)
        if known is not None:
            return known
        _require_room(uow, row)
        frame, held = held_pins(uow, of_map, pins)
        uow.blobs.refer(row.tenant, [blob_of_plan(row)])
        added = uow.plans.add(replace(row, frame=frame, pins=tuple(pin.row() for pin in held)))
        audit.append(uow, row.created_at_ns, entry)
        return CreatedPlan(plan_seen(uow, added), replay=False)

    async def get(self, tenant: TenantId, map_id: str, plan_id: str) -> PlanView:
        """Raises NotFound."""
        return await self._context.storage.read(lambda uow: plan_seen(uow, _require_plan(uow, tenant, map_id, plan_id)))

    async def list(self, tenant: TenantId, map_id: str, page: PageRequest) -> Page[PlanView]:
        """The plans of a map, oldest first. Raises NotFound."""
        find = rows_of_map(lambda uow: uow.plans, tenant, map_id)
        return await self._context.lists.page(tenant, page, find, plan_seen)

    async def pin(self, tenant: TenantId, map_id: str, plan_id: str, pins: Sequence[PlanPin]) -> PlanView:
        """Hold a plan by other pins. Raises NotFound, BadField, Draining, RateLimited."""
        self._context.admission.charge_creation(tenant)
        entry = audit.noted(tenant, "plan_pinned", f"maps/{map_id}/plans/{plan_id}")
        return await self._context.storage.write(
            partial(self._pin, map_id=map_id, plan_id=plan_id, pins=pins, entry=entry)
        )

    def _pin(self, uow: UnitOfWork, map_id: str, plan_id: str, pins: Sequence[PlanPin], entry: AuditEntry) -> PlanView:
        tenant = TenantId(entry.tenant)
        of_map = require_map(uow, tenant, map_id, hold=True)
        record = _require_plan(uow, tenant, map_id, plan_id)
        frame, held = held_pins(uow, of_map, two_pins(pins, record.width_px, record.height_px))
        pinned = replace(record, frame=frame, pins=tuple(pin.row() for pin in held))
        uow.plans.replace(pinned)
        audit.append(uow, self._context.clock.wall_ns(), entry)
        return plan_seen(uow, pinned)

    async def delete(self, tenant: TenantId, map_id: str, plan_id: str) -> None:
        """Delete a plan with its picture. Raises NotFound, Draining."""
        self._context.admission.require_running()
        entry = audit.noted(tenant, "plan_deleted", f"maps/{map_id}/plans/{plan_id}")
        await self._context.storage.write(partial(self._delete, map_id=map_id, plan_id=plan_id, entry=entry))

    def _delete(self, uow: UnitOfWork, map_id: str, plan_id: str, entry: AuditEntry) -> None:
        tenant = TenantId(entry.tenant)
        require_map(uow, tenant, map_id, hold=True)
        forget_plan(uow, _require_plan(uow, tenant, map_id, plan_id))
        audit.append(uow, self._context.clock.wall_ns(), entry)

    async def picture(self, tenant: TenantId, record: PlanRecord, room: Room) -> Download:
        """The picture of a plan as it was sent, once `room` has room for it. Raises DataLoss, WorkersBusy."""
        await room(record.size_bytes)
        data = await asyncio.to_thread(self._context.storage.blobs.get, tenant, PLAN_BLOB, record.image_sha256)
        return Download(data, record.media_type, f"{record.map_id}-{record.plan_id}.{EXTENSIONS[record.media_type]}")


def _row(tenant: TenantId, new: NewPlan, now_ns: int) -> tuple[PlanRecord, tuple[PlanPin, PlanPin]]:
    """The row of a new plan, without what its map says of its pins. Raises as `create`."""
    validated_id(new.plan_id, "plan_id")
    validated_label(new.display_name, "display_name")
    storey = validated_detail(new.storey or None, "storey")
    picture = _picture(new.image)
    pins = two_pins(new.pins, picture.width, picture.height)
    sha256 = hashlib.sha256(new.image).hexdigest()
    placed = [number for pin in pins for number in (*pin.pixel, *pin.ground)]
    row = PlanRecord(
        tenant=tenant,
        map_id=new.map_id,
        plan_id=new.plan_id,
        content_hash=content_hash((sha256, new.display_name, storey, *placed)),
        display_name=new.display_name,
        storey=storey,
        media_type=picture.media_type,
        width_px=picture.width,
        height_px=picture.height,
        size_bytes=len(new.image),
        image_sha256=sha256,
        frame="",
        pins=(),
        created_at_ns=now_ns,
    )
    return row, pins


def _picture(image: bytes) -> Picture:
    """Raises TooLarge, UnsupportedEncoding, MalformedBody."""
    if len(image) > limits.PLAN_IMAGE_BYTES:
        most = limits.PLAN_IMAGE_BYTES >> 20
        raise TooLarge(f"a picture may have at most {most} MiB, this one has {len(image) >> 20}", field="image")
    return read_picture(image, PICTURES)


def _replayed(uow: UnitOfWork, row: PlanRecord) -> CreatedPlan | None:
    """The plan, where it was created before. Raises NotFound, AlreadyExists."""
    require_map(uow, row.tenant, row.map_id)
    known = uow.plans.get(row.tenant, row.map_id, row.plan_id)
    if known is None:
        return None
    require_same_content(known.content_hash, row.content_hash, f"plan {row.plan_id}")
    return CreatedPlan(plan_seen(uow, known), replay=True)


def _require_room(uow: UnitOfWork, row: PlanRecord) -> None:
    """Raises BadField, TooLarge where a map would have too many plans, or too large ones."""
    there = uow.plans.find(row.tenant, map_id=row.map_id)
    if len(there) >= limits.PLANS_OF_MAP:
        raise BadField(f"a map has at most {limits.PLANS_OF_MAP} plans: delete one", field="plan_id")
    if sum(plan.size_bytes for plan in there) + row.size_bytes > limits.PLAN_BYTES_OF_MAP:
        most = limits.PLAN_BYTES_OF_MAP >> 20
        raise TooLarge(f"the plans of a map have at most {most} MiB together: delete one", field="image")


def _require_plan(uow: UnitOfWork, tenant: TenantId, map_id: str, plan_id: str) -> PlanRecord:
    require_map(uow, tenant, map_id)
    known = uow.plans.get(tenant, map_id, plan_id)
    if known is None:
        raise NotFound(f"map {map_id!r} has no plan {plan_id!r}"[:300])
    return known

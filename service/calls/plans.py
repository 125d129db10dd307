"""Plans of maps."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable

from revisit.service.domain.identity import TenantId
from revisit.service.features.plans.calls import NewPlan
from revisit.service.features.plans.rules import PlanPin, PlanView
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_of
from revisit.service.wire.rendering import Answer
from revisit.v1 import plan_pb2


async def create_plan(cases: UseCases, tenant: TenantId, request: plan_pb2.CreatePlanRequest) -> Answer:
    """A picture as a plan of a map."""
    map_id = names.map_id(request.parent, "parent")
    of = (map_id, request.plan_id, request.image, _pins(request.pins), request.display_name, request.storey)
    created = await cases.plans.create(tenant, NewPlan(*of))
    return {"plan": plan_fields(created.plan), "replay": created.replay}


async def pin_plan(cases: UseCases, tenant: TenantId, request: plan_pb2.PinPlanRequest) -> Answer:
    """A plan with other pins."""
    key = names.plan_key(request.name)
    return {"plan": plan_fields(await cases.plans.pin(tenant, *key, _pins(request.pins)))}


async def download_plan(
    cases: UseCases, tenant: TenantId, request: plan_pb2.DownloadPlanRequest
) -> AsyncIterator[Fields]:
    """The picture in chunks; the first one has its type."""
    plan = await cases.plans.get(tenant, *names.plan_key(request.name))
    with cases.budget.hold(tenant) as held:
        file = await cases.plans.picture(tenant, plan.record, held.wait_for)
        for chunk in requests.chunks(file):
            yield chunk


def _pins(sent: Iterable[plan_pb2.PlanPin]) -> list[PlanPin]:
    return [PlanPin(pin.pixel_x, pin.pixel_y, pin.x_m, pin.y_m) for pin in sent]


def plan_fields(view: PlanView) -> Fields:
    """The fields of a Plan."""
    plane = view.plane
    return fields_of(
        plan_pb2.Plan,
        view.record,
        storey=view.record.storey or "",
        pins=[vars(pin) for pin in view.pins],
        frame=view.frame,
        map_version=view.map_version,
        metres_per_pixel=plane.metres_per_pixel,
        turn_rad=plane.turn_rad,
    )

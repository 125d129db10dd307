"""`/v1/maps/{map}/plans` with a picture as body, and as answer."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Response
from starlette.requests import Request

from revisit.api.calls import CALLS
from revisit.core.errors import UnsupportedEncoding
from revisit.formats.pictures import JPEG, PNG, kind_of
from revisit.service.calls import plans
from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId
from revisit.service.rest.access import served
from revisit.service.rest.answers import answer, answers
from revisit.service.rest.bodies import ANY_BINARY, body_bytes, media_type, parse_numbers
from revisit.service.rest.entity_tags import etag_of, is_known
from revisit.service.rest.files import FileInPieces
from revisit.service.rest.parameters import Cases, Id, Tenant
from revisit.service.rest.request_form import form_of
from revisit.service.use_cases import UseCases
from revisit.v1 import plan_pb2

router = APIRouter()

PIN_ORDER = "pixel x, pixel y, x in metres, y in metres"

_PICTURE = {"requestBody": {"required": True, "content": {PNG: ANY_BINARY, JPEG: ANY_BINARY}}}

_SHOWN: dict[str, Any] = {
    "response_class": Response,
    "responses": {
        200: {"content": {PNG: ANY_BINARY, JPEG: ANY_BINARY}, "description": "The picture"},
        304: {"description": "The picture is the one that `If-None-Match` names"},
    },
}

_ALONE = {"content-security-policy": "default-src 'none'; sandbox", "cache-control": "private, no-cache"}
"""A picture is no page, whatever it claims; a browser may keep it, and asks whether it is still there."""

_NEW = form_of(CALLS["CreatePlan"], frozenset({"image", "pins"}))

Pins = Annotated[list[Annotated[str, Query(max_length=200)]], Query(max_length=2, description=PIN_ORDER)]


async def _image(request: Request, cases: Cases, tenant: Tenant) -> bytes:
    """The body, of the kind that its Content-Type names; one that will be refused is not even read."""
    if media_type(request) not in (PNG, JPEG) or request.headers.get("content-encoding"):
        raise UnsupportedEncoding(f"a plan is {PNG} or {JPEG} without Content-Encoding", field="image")
    cases.plans.precheck(tenant)
    image = await body_bytes(request, limits.PLAN_IMAGE_BYTES)
    if kind_of(image) != media_type(request):
        raise UnsupportedEncoding(f"this is {kind_of(image)}, but was sent as {media_type(request)}", field="image")
    return image


@router.api_route(**served(CALLS["CreatePlan"]), **answers(plan_pb2.Plan, 201), openapi_extra=_PICTURE)
@_NEW.asked_by(pins=Pins, image=Annotated[bytes, Depends(_image)], cases=Cases, tenant=Tenant)
async def create_plan(pins: list[str], image: bytes, cases: UseCases, tenant: TenantId, **values: Any) -> Response:
    """Keep a picture, PNG or JPEG, as a plan of a map, held by two pins."""
    asked: Any = _NEW.message(values, None)
    for text in pins:
        numbers = parse_numbers(text, 4, "pins", PIN_ORDER)
        asked.pins.add(**dict(zip(("pixel_x", "pixel_y", "x_m", "y_m"), numbers, strict=True)))
    asked.image = image
    created: Any = await plans.create_plan(cases, tenant, asked)
    return answer(plan_pb2.Plan, created["plan"], 201, replay=created["replay"])


@router.api_route(**served(CALLS["DownloadPlan"]), **_SHOWN)
async def download_plan(
    map_id: Id,
    plan_id: Id,
    cases: Cases,
    tenant: Tenant,
    if_none_match: Annotated[str | None, Header(alias="If-None-Match", max_length=1000)] = None,
) -> Response:
    """The picture of a plan as it was sent; its ETag is its hash."""
    record = (await cases.plans.get(tenant, map_id, plan_id)).record
    etag = etag_of(record.image_sha256)
    headers = {**_ALONE, "etag": etag}
    if is_known(if_none_match, etag):
        return Response(status_code=304, headers=headers)
    return FileInPieces(cases.budget, tenant, partial(cases.plans.picture, tenant, record), headers)

"""`/v1/webhooks`."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Response

from revisit.service.application.access.callers import Scope
from revisit.service.rest.access import allows
from revisit.service.rest.answers import (
    CreatedWebhook,
    DeliveryPage,
    Webhook,
    WebhookPage,
    answer,
    answers,
    page_answer,
)
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.schemas import CreateWebhookRequest
from revisit.service.wire.answers import of_created_webhook, of_delivery, of_webhook

router = APIRouter(prefix="/v1/webhooks", tags=["webhooks"])


@router.post(
    "",
    **answers(CreatedWebhook, 201),
    openapi_extra=describe_json(CreateWebhookRequest),
    dependencies=[allows(Scope.ADMIN)],
)
async def create_webhook(
    body: Annotated[CreateWebhookRequest, json_body(CreateWebhookRequest)], cases: Cases, tenant: Tenant
) -> Response:
    """Send the events from now on to a URL. The secret that signs them is told this once."""
    created = await cases.webhooks.create(tenant, body.command())
    return answer(CreatedWebhook, of_created_webhook(created), 201, replay=created.replay)


@router.get("", **answers(WebhookPage), dependencies=[allows(Scope.ADMIN)])
async def list_webhooks(cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the webhooks, oldest first."""
    return await page_answer(WebhookPage, "webhooks", await cases.webhooks.list(tenant, paging), of_webhook)


@router.post("/{webhook_id}:resume", **answers(Webhook), dependencies=[allows(Scope.ADMIN)])
async def resume_webhook(webhook_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Try again at once, also where it was suspended."""
    return answer(Webhook, of_webhook(await cases.webhooks.resume(tenant, webhook_id)))


@router.get("/{webhook_id}/deliveries", **answers(DeliveryPage), dependencies=[allows(Scope.ADMIN)])
async def list_webhook_deliveries(webhook_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """The last attempts to deliver, oldest first."""
    page = await cases.webhooks.deliveries(tenant, webhook_id, paging)
    return await page_answer(DeliveryPage, "webhook_deliveries", page, of_delivery)


@router.get("/{webhook_id}", **answers(Webhook), dependencies=[allows(Scope.ADMIN)])
async def get_webhook(webhook_id: Id, cases: Cases, tenant: Tenant) -> Response:
    """Get a webhook."""
    return answer(Webhook, of_webhook(await cases.webhooks.get(tenant, webhook_id)))


@router.delete("/{webhook_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_webhook(webhook_id: Id, cases: Cases, tenant: Tenant) -> None:
    """Send nothing more."""
    await cases.webhooks.delete(tenant, webhook_id)

"""WebhookService."""

from __future__ import annotations

from typing import Any

from revisit.service.application import UseCases
from revisit.service.grpc.tenancy import tenant_of
from revisit.service.wire import answers, names, requests
from revisit.v1 import webhook_pb2 as pb
from revisit.v1 import webhook_pb2_grpc


class WebhookServicer(webhook_pb2_grpc.WebhookServiceServicer):
    """Create, get, list, resume and delete webhooks; list what came of their deliveries."""

    def __init__(self, use_cases: UseCases) -> None:
        """Answers from `use_cases`."""
        self._webhooks = use_cases.webhooks

    async def CreateWebhook(self, request: pb.CreateWebhookRequest, context: Any) -> pb.CreateWebhookResponse:
        """Create a webhook."""
        created = await self._webhooks.create(tenant_of(context), requests.create_webhook(request))
        return pb.CreateWebhookResponse(**answers.of_created_webhook(created))

    async def GetWebhook(self, request: pb.GetWebhookRequest, context: Any) -> pb.GetWebhookResponse:
        """Get a webhook."""
        view = await self._webhooks.get(tenant_of(context), names.webhook_id(request.name))
        return pb.GetWebhookResponse(webhook=answers.of_webhook(view))

    async def ListWebhooks(self, request: pb.ListWebhooksRequest, context: Any) -> pb.ListWebhooksResponse:
        """List the webhooks."""
        page = await self._webhooks.list(tenant_of(context), requests.page(request))
        return pb.ListWebhooksResponse(**answers.of_page("webhooks", page, answers.of_webhook))

    async def DeleteWebhook(self, request: pb.DeleteWebhookRequest, context: Any) -> pb.DeleteWebhookResponse:
        """Delete a webhook."""
        await self._webhooks.delete(tenant_of(context), names.webhook_id(request.name))
        return pb.DeleteWebhookResponse()

    async def ResumeWebhook(self, request: pb.ResumeWebhookRequest, context: Any) -> pb.ResumeWebhookResponse:
        """Try again at once."""
        view = await self._webhooks.resume(tenant_of(context), names.webhook_id(request.name))
        return pb.ResumeWebhookResponse(webhook=answers.of_webhook(view))

    async def ListWebhookDeliveries(
        self, request: pb.ListWebhookDeliveriesRequest, context: Any
    ) -> pb.ListWebhookDeliveriesResponse:
        """List the last attempts."""
        webhook_id = names.webhook_id(request.parent, "parent")
        page = await self._webhooks.deliveries(tenant_of(context), webhook_id, requests.page(request))
        return pb.ListWebhookDeliveriesResponse(**answers.of_page("webhook_deliveries", page, answers.of_delivery))

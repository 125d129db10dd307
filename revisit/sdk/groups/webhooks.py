"""Webhooks: where events are sent."""

from __future__ import annotations

import builtins
from collections.abc import Sequence
from dataclasses import replace

from revisit.sdk import names
from revisit.sdk.groups.group import Group
from revisit.sdk.names import name_of
from revisit.sdk.resources import Map, Webhook, WebhookDelivery


class Webhooks(Group):
    """`client.webhooks`."""

    def create(self, webhook_id: str, url: str, *, map_: str | Map | None = None, kinds: Sequence[str] = ()) -> Webhook:
        """Send the events from now on to a URL (https), those of one map where given; `kinds` as in `Client.watch`.

        The answer holds the `secret` that signs them, this once: `revisit.sdk.webhooks.verified` checks with it.
        """
        of_map = None if map_ is None else name_of(map_, names.MAP)
        created = self._ask("CreateWebhook", webhook_id=webhook_id, url=url, map=of_map, kinds=[*kinds])
        return replace(Webhook.of(created.webhook), secret=created.secret)

    def get(self, name: str) -> Webhook:
        """Get `webhooks/{webhook}`."""
        return Webhook.of(self._ask("GetWebhook", name=name_of(name, names.WEBHOOK)))

    def list(self) -> builtins.list[Webhook]:
        """All webhooks, oldest first."""
        return self._list(Webhook, "ListWebhooks")

    def resume(self, webhook: str | Webhook) -> Webhook:
        """Try again at once, also where it was suspended."""
        return Webhook.of(self._ask("ResumeWebhook", name=name_of(webhook, names.WEBHOOK)))

    def delete(self, webhook: str | Webhook) -> None:
        """Send nothing more."""
        self._ask("DeleteWebhook", name=name_of(webhook, names.WEBHOOK))

    def deliveries(self, webhook: str | Webhook) -> builtins.list[WebhookDelivery]:
        """The last attempts to deliver, oldest first."""
        return self._list(WebhookDelivery, "ListWebhookDeliveries", parent=name_of(webhook, names.WEBHOOK))

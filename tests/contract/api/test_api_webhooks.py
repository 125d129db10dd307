"""Webhooks over both transports: created once with their secret, listed without, bounded, of one tenant."""

from __future__ import annotations

import itertools

import httpx
import pytest

from revisit import Client
from revisit.sdk.errors import AlreadyExists, InvalidArgument, NotFound, PermissionDenied, ResourceExhausted
from revisit.service.domain import limits
from tests.support.credentials import a_key

URL = "https://hooks.example.com/revisit"
_numbers = itertools.count(1)


@pytest.fixture
def webhook_id(client):
    """Whatever a test makes is deleted again: a tenant may have few."""
    yield f"hook-{next(_numbers)}"
    for webhook in client.list_webhooks():
        client.delete(webhook)


def test_a_webhook_is_created_got_listed_and_deleted(client, town, webhook_id):
    made = client.create_webhook(webhook_id, URL, map_=town, kinds=["LOOP_CLOSURE"])
    assert made.secret.startswith("whsec_") and len(made.secret) > 40
    assert made.secret not in repr(made)
    assert (made.name, made.url, made.map, made.kinds) == (f"webhooks/{webhook_id}", URL, town, ("LOOP_CLOSURE",))
    assert (made.state, made.failures) == ("ENABLED", 0)
    assert client.get_webhook(made.name) == made
    assert [hook for hook in client.list_webhooks() if hook.map == town] == [made]
    assert client.webhook_deliveries(made) == []
    client.delete(made)
    with pytest.raises(NotFound):
        client.get_webhook(made.name)


def test_the_secret_is_told_once(client, webhook_id):
    first, again = client.create_webhook(webhook_id, URL), client.create_webhook(webhook_id, URL)
    assert first == again
    assert (bool(first.secret), again.secret) == (True, "")
    with pytest.raises(AlreadyExists):
        client.create_webhook(webhook_id, f"{URL}/other")


@pytest.mark.parametrize("url", ["http://hooks.example.com/", "https://127.0.0.1/", "https://localhost/", "nonsense"])
def test_an_url_that_leads_inside_is_refused(client, url, webhook_id):
    with pytest.raises(InvalidArgument) as refused:
        client.create_webhook(webhook_id, url)
    assert (refused.value.reason, refused.value.field) == ("BAD_FIELD", "url")


def test_what_does_not_exist_cannot_be_told_of(client, webhook_id):
    with pytest.raises(NotFound):
        client.create_webhook(webhook_id, URL, map_="maps/nowhere")
    with pytest.raises(InvalidArgument):
        client.create_webhook(webhook_id, URL, kinds=["FORGOTTEN"])
    with pytest.raises(InvalidArgument):
        client.create_webhook(webhook_id, URL, kinds=["EVERYTHING"])
    for call in (client.resume_webhook, client.webhook_deliveries, client.delete):
        with pytest.raises(NotFound):
            call("webhooks/none")


def test_a_tenant_has_few_webhooks(client, webhook_id):
    for number in range(limits.WEBHOOKS):
        client.create_webhook(f"{webhook_id}-{number}", URL)
    with pytest.raises(ResourceExhausted) as refused:
        client.create_webhook(webhook_id, URL)
    assert refused.value.reason == "QUOTA"


def test_webhooks_are_for_administrators_and_of_one_tenant(guarded):
    keys = {
        name: a_key(guarded.world, tenant=tenant, scopes=scopes).text
        for name, tenant, scopes in (
            ("admin", "acme", ("admin",)),
            ("reader", "acme", ("query", "ingest")),
            ("other", "rival", ("admin",)),
        )
    }
    clients = {name: Client(guarded.http, api_key=key) for name, key in keys.items()}
    made = clients["admin"].create_webhook("mine", URL)
    with pytest.raises(PermissionDenied):
        clients["reader"].list_webhooks()
    assert clients["other"].list_webhooks() == []
    with pytest.raises(NotFound):
        clients["other"].get_webhook(made.name)
    with pytest.raises(NotFound):
        clients["other"].delete(made)
    for client in clients.values():
        client.close()


def test_the_secret_is_in_no_answer_but_the_first(service, client, webhook_id):
    made = client.create_webhook(webhook_id, URL)
    for path in ("", f"/{webhook_id}", f"/{webhook_id}/deliveries"):
        answer = httpx.get(f"{service.http}/v1/webhooks{path}", trust_env=False)
        assert answer.status_code == 200
        assert made.secret not in answer.text

"""Deliveries to a receiver that works, fails, hangs, redirects or is somewhere it must not be."""

from __future__ import annotations

import asyncio
import http.server
import json
import ssl
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest
import trustme

from revisit.sdk.errors import Unauthenticated
from revisit.sdk.webhooks import verified
from revisit.service.adapters import webhook_sender
from revisit.service.adapters.webhook_sender import HttpWebhookSender
from revisit.service.calls.push import webhook_body
from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import EventKind
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.webhooks import deliveries
from revisit.service.features.webhooks.calls import CreateWebhook
from revisit.service.features.webhooks.deliveries import MOST_FAILURES, Deliveries, pause_s
from tests.support.patience import PATIENCE_S, eventually
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, sqlite_world, submap

PAGE = PageRequest(500)


@dataclass
class Receiver:
    """Keeps what it gets; answers each request with the next of `answers`, else 204."""

    url: str = ""
    answers: list[int] = field(default_factory=list)
    requests: list[tuple[dict[str, str], bytes]] = field(default_factory=list)
    hold: threading.Event | None = None
    tls: ssl.SSLContext | None = None

    def events(self, secret):
        """The events of all requests that were answered well, each verified."""
        told = (verified(body, headers, secret, now_s=now_of(headers)) for headers, body in self.requests)
        return [event for events in told for event in events]


def now_of(headers):
    return float({name.lower(): value for name, value in headers.items()}["webhook-timestamp"])


@contextmanager
def receiver(**given):
    made = Receiver(**given)

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["content-length"]))
            made.requests.append((dict(self.headers), body))
            if made.hold is not None:
                made.hold.wait(PATIENCE_S)
            status = made.answers.pop(0) if made.answers else 204
            self.send_response(status)
            if status == 302:
                self.send_header("location", made.url + "elsewhere")
            self.end_headers()

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    if made.tls is not None:
        server.socket = made.tls.wrap_socket(server.socket, server_side=True)
    made.url = f"http://127.0.0.1:{server.server_port}/"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield made
    finally:
        if made.hold is not None:
            made.hold.set()
        server.shutdown()
        server.server_close()


def delivering(world, *, private_networks=True):
    sender = HttpWebhookSender(private_networks=private_networks)
    return Deliveries(world.context.storage, sender, world.context.clock, webhook_body)


async def once(of):
    await of.deliver_due()
    await of.settle()


async def hooked(world, url, **options):
    """A webhook in a world with an open session; its secret."""
    created = await world.use_cases.webhooks.create(TENANT, CreateWebhook("hook", url, **options))
    return created.secret


async def post(world, *places):
    for index, place in enumerate(places):
        await world.use_cases.posting.post(TENANT, submap(f"s{place}-{index}-{time.monotonic_ns()}", place))
    world.work_off()


@pytest.fixture
def world():
    return memory_world(webhook_private_networks=True)


async def test_events_arrive_signed_in_order_and_once(world):
    await open_session(world)
    with receiver() as there:
        secret = await hooked(world, there.url)
        await post(world, 1, 30, 60, 1)
        sending = delivering(world)
        for _ in range(3):
            await once(sending)
        events = there.events(secret)
        numbers = [event.number for event in events]
        assert numbers == sorted(set(numbers))
        loops = [event.loop_closure for event in events if event.kind == "LOOP_CLOSURE"]
        assert [loop.state for loop in loops] == ["ACCEPTED"]
        assert len(there.requests) == 1
        headers, body = there.requests[0]
        assert json.loads(body)["webhook"] == "webhooks/hook"
        with pytest.raises(Unauthenticated, match="too old"):
            verified(body, headers, secret, now_s=now_of(headers) + 301)
        with pytest.raises(Unauthenticated, match="signature"):
            verified(body + b" ", headers, secret, now_s=now_of(headers))
        (delivery,) = (await world.use_cases.webhooks.deliveries(TENANT, "hook", PAGE)).items
        assert (delivery.status, delivery.error, delivery.attempt) == (204, None, 1)
        await sending.close()


async def test_a_body_is_bounded_and_what_does_not_fit_comes_with_the_next(world, monkeypatch):
    monkeypatch.setattr(deliveries, "BODY_BYTES", 3_000)
    await open_session(world)
    with receiver() as there:
        secret = await hooked(world, there.url)
        await post(world, *range(1, 100, 10), 1)
        sending = delivering(world)
        for _ in range(40):
            await once(sending)
        events = there.events(secret)
        assert [event.number for event in events] == sorted({event.number for event in events})
        assert len({event.operation.subject for event in events if event.operation}) == 11
        assert {event.kind for event in events} == {"OPERATION", "LOOP_CLOSURE"}
        sizes = [len(body) for _, body in there.requests]
        assert len(sizes) > 3 and max(sizes) < 3_000 < sum(sizes)
        monkeypatch.setattr(deliveries, "BODY_BYTES", 100)
        await post(world, 200)
        for _ in range(4):
            await once(sending)
        told = [json.loads(body)["events"] for _, body in there.requests[len(sizes) :]]
        assert told and all(len(one) == 1 for one in told)  # an event that is larger by itself is sent, too
        await sending.close()


async def test_a_failure_is_tried_again_after_a_pause_that_grows_and_loses_nothing(world):
    await open_session(world)
    with receiver(answers=[500, 503]) as there:
        secret = await hooked(world, there.url, kinds=(EventKind.OPERATION,))
        await post(world, 1)
        sending = delivering(world)
        await once(sending)
        await once(sending)
        assert len(there.requests) == 1, "it was not waited for"
        world.clock.ms += 5_001
        await once(sending)
        assert len(there.requests) == 2
        world.clock.ms += 5_001
        await post(world, 30)
        world.clock.ms += 5_000
        await once(sending)
        webhook = await world.use_cases.webhooks.get(TENANT, "hook")
        assert (webhook.failures, webhook.state) == (0, "ENABLED")
        last = verified(there.requests[-1][1], there.requests[-1][0], secret, now_s=now_of(there.requests[-1][0]))
        assert len({event.operation.name for event in last}) == 2
        log = (await world.use_cases.webhooks.deliveries(TENANT, "hook", PAGE)).items
        assert [(entry.attempt, entry.status) for entry in log] == [(1, 500), (2, 503), (3, 204)]
        await sending.close()


async def test_a_restart_goes_on_where_it_was(tmp_path):
    world = sqlite_world(tmp_path, webhook_private_networks=True)
    await open_session(world)
    with receiver(answers=[500]) as there:
        secret = await hooked(world, there.url)
        await post(world, 1)
        first = delivering(world)
        await once(first)
        await first.close()
        world.context.transactions.close()
        again = sqlite_world(tmp_path, webhook_private_networks=True)
        again.clock.ms = world.clock.ms + 10_000
        second = delivering(again)
        await once(second)
        assert len(there.requests) == 2
        assert there.requests[0][1] == there.requests[1][1]
        assert len({event.number for event in there.events(secret)}) == len(there.events(secret)) // 2
        await second.close()
        again.context.transactions.close()


@pytest.mark.parametrize(("answers", "rounds"), [([410], 1), ([500] * MOST_FAILURES, MOST_FAILURES)])
async def test_a_receiver_that_is_gone_is_left_alone_until_it_is_resumed(world, answers, rounds):
    await open_session(world)
    with receiver(answers=list(answers)) as there:
        await hooked(world, there.url)
        await post(world, 1)
        sending = delivering(world)
        for _ in range(rounds + 2):
            await once(sending)
            world.clock.ms += 3_600_001
        assert len(there.requests) == rounds
        assert (await world.use_cases.webhooks.get(TENANT, "hook")).state == "SUSPENDED"
        await world.use_cases.webhooks.resume(TENANT, "hook")
        await once(sending)
        assert len(there.requests) == rounds + 1
        assert (await world.use_cases.webhooks.get(TENANT, "hook")).failures == 0
        await sending.close()


@pytest.mark.parametrize("url", ["https://localhost/", "https://127.0.0.1/", "https://[::1]/", "https://0/"])
async def test_nothing_is_sent_to_a_private_address_whatever_the_name_said_before(url, monkeypatch):
    opened = []
    monkeypatch.setattr(asyncio.BaseEventLoop, "create_connection", lambda *a, **k: opened.append(a))
    sender = HttpWebhookSender()
    answered = await sender.send(url, b"{}", {})
    assert answered.status is None
    assert "leads to a private address" in str(answered.error)
    assert opened == []
    await sender.close()


async def test_a_name_with_one_private_address_among_others_is_refused(monkeypatch):
    async def rebound(*_, **__):
        return [(2, 1, 6, "", ("93.184.215.14", 443)), (2, 1, 6, "", ("10.0.0.1", 443))]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", rebound)
    sender = HttpWebhookSender()
    assert "private" in str((await sender.send("https://rebind.example/", b"{}", {})).error)
    await sender.close()


async def test_a_redirect_is_an_answer_and_not_followed(world):
    await open_session(world)
    with receiver(answers=[302]) as there:
        await hooked(world, there.url)
        await post(world, 1)
        sending = delivering(world)
        await once(sending)
        assert len(there.requests) == 1
        (delivery,) = (await world.use_cases.webhooks.deliveries(TENANT, "hook", PAGE)).items
        assert delivery.status == 302
        assert (await world.use_cases.webhooks.get(TENANT, "hook")).failures == 1
        await sending.close()


async def test_a_receiver_that_hangs_holds_up_nobody(world, monkeypatch):
    monkeypatch.setattr(webhook_sender, "WHOLE_S", 2 * PATIENCE_S)
    await open_session(world)
    with receiver(hold=threading.Event()) as hanging, receiver() as there:
        await hooked(world, hanging.url)
        await world.use_cases.webhooks.create(TENANT, CreateWebhook("well", there.url))
        await post(world, 1)
        sending = delivering(world)
        await sending.deliver_due()
        await asyncio.to_thread(eventually, lambda: there.requests)
        await sending.close()


async def test_receivers_of_four_tenants_that_hang_do_not_delay_a_fifth(world):
    with receiver(hold=threading.Event()) as stuck, receiver() as fine:
        tenants = [TenantId(f"slow-{number}") for number in range(deliveries.AT_ONCE // deliveries.OF_TENANT)]
        for tenant in tenants:
            for number in range(deliveries.OF_TENANT):
                await world.use_cases.webhooks.create(tenant, CreateWebhook(f"h{number}", stuck.url))
            await heard_of(world, tenant)
        of = delivering(world)
        await of.deliver_due()
        await hooked(world, fine.url)
        await heard_of(world, TENANT)
        await of.deliver_due()
        await asyncio.to_thread(eventually, lambda: fine.requests, "the event waits for the others' receivers")
        await of.close()


async def heard_of(world, tenant):
    """Something happens in a map of the tenant."""
    await open_session(world, tenant=tenant)
    await world.use_cases.posting.post(tenant, submap("a", 1))
    world.work_off()


async def test_a_receiver_that_hangs_is_given_up(world, monkeypatch):
    monkeypatch.setattr(webhook_sender, "WHOLE_S", 0.25)
    await open_session(world)
    with receiver(hold=threading.Event()) as hanging:
        await hooked(world, hanging.url)
        await post(world, 1)
        sending = delivering(world)
        await once(sending)
        (delivery,) = (await world.use_cases.webhooks.deliveries(TENANT, "hook", PAGE)).items
        assert delivery.error == "no answer within 0.25 s"
        await sending.close()


async def test_a_webhook_of_one_map_is_not_told_of_others(world):
    await open_session(world)
    other = SESSION.__class__("yard", "monday")
    await open_session(world, other)
    with receiver() as there:
        secret = await hooked(world, there.url, map_id="yard")
        await post(world, 1)
        await world.use_cases.posting.post(TENANT, submap("y", 30, other))
        world.work_off()
        sending = delivering(world)
        await once(sending)
        assert {event.map for event in there.events(secret)} == {"maps/yard"}
        await sending.close()


async def test_a_webhook_of_all_maps_goes_on_in_each_of_them_where_it_was(tmp_path):
    """Events of two maps have the same numbers; the second map is made later, and the service starts anew."""
    world = sqlite_world(tmp_path, webhook_private_networks=True)
    await open_session(world)
    await post(world, 1)
    with receiver(answers=[204, 500]) as there:
        secret = await hooked(world, there.url)
        await post(world, 30)
        sending = delivering(world)
        await once(sending)
        other = SESSION.__class__("yard", "monday")
        await open_session(world, other)
        await world.use_cases.posting.post(TENANT, submap("y", 60, other))
        await post(world, 90)
        await once(sending)  # in vain
        await sending.close()
        world.context.transactions.close()
        world = sqlite_world(tmp_path, clock=world.clock, webhook_private_networks=True)
        world.clock.ms += 10_000_000
        sending = delivering(world)
        await once(sending)
        await once(sending)
        refused = there.requests.pop(1)
        told = [(event.map, event.number) for event in there.events(secret)]
        await sending.close()

    def logged(uow):
        return [(f"maps/{name}", uow.events.following(TENANT, name, 0, 100)) for name in ("town", "yard")]

    events = {
        (name, row.number): row for name, rows in world.context.transactions.read(logged).result() for row in rows
    }
    assert len(told) == len(set(told)) and set(told) <= set(events)
    assert {events[one].subject for one in told} == {row.subject for row in events.values()} - first_operation(events)
    assert ids_of(refused) == ids_of(there.requests[1])
    assert len({ids_of(one) for one in there.requests}) == len(there.requests)
    world.context.transactions.close()


def first_operation(events) -> set[str]:
    """The operation that had ended before the webhook was there."""
    return {events["maps/town", 1].subject}


def ids_of(request) -> str:
    headers, _ = request
    return {name.lower(): value for name, value in headers.items()}["webhook-id"]


async def test_the_log_of_deliveries_is_bounded(world, monkeypatch):
    monkeypatch.setattr(deliveries, "KEPT", 3)
    await open_session(world)
    with receiver() as there:
        await hooked(world, there.url)
        sending = delivering(world)
        for place in range(6):
            await post(world, place)
            await once(sending)
        kept = (await world.use_cases.webhooks.deliveries(TENANT, "hook", PAGE)).items
        assert len(kept) == 3
        assert len(there.requests) == 6
        await sending.close()


def test_pauses_double_up_to_an_hour():
    for failures, whole_s in ((1, 5.0), (2, 10.0), (5, 80.0), (11, 3600.0), (1000, 3600.0)):
        assert all(whole_s / 2 <= pause_s(failures) <= whole_s for _ in range(20))


@pytest.fixture(scope="module")
def authority():
    return trustme.CA()


@pytest.mark.parametrize(("certified", "status"), [("hooks.test", 204), ("other.test", None)])
async def test_the_certificate_is_that_of_the_name_though_the_address_was_chosen(
    monkeypatch, authority, certified, status
):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    authority.issue_cert(certified).configure_cert(context)
    trusted = ssl.create_default_context()
    authority.configure_trust(trusted)
    with receiver(tls=context) as there:
        port = int(there.url.rpartition(":")[2].strip("/"))

        async def here(*_, **__):
            return [(2, 1, 6, "", ("127.0.0.1", port))]

        sender = HttpWebhookSender(private_networks=True, trusted=trusted)
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", here)
        answered = await sender.send(f"https://hooks.test:{port}/path", b"{}", {"content-length": "2"})
        assert answered.status == status
        assert (answered.error is None) == (status is not None)
        if status is not None:
            assert there.requests[0][0]["host"] == f"hooks.test:{port}"
        await sender.close()

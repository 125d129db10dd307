"""Watching a map: each event once and in order, over both transports, through cuts; only for those who may."""

from __future__ import annotations

import asyncio
import itertools
import json
import queue
import socket
import threading

import httpx
import pytest

from revisit import Client
from revisit.sdk.errors import ErrorDetails, NotFound, ResourceExhausted, Unauthenticated
from revisit.sdk.retry import RetryPolicy
from revisit.service.domain.states import EventKind
from revisit.service.features.events.calls import Events, EventView
from revisit.service.rest import access
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.slow_clients import DeadlineProtocol
from tests.faults.proxy import Fault, bad_link
from tests.support.credentials import a_key
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S, eventually
from tests.support.service_world import cloud_points, pose

SOON = RetryPolicy(attempts=1, base_s=0.01, cap_s=0.05)


def post(client, session, submap_id, place):
    return client.post_submap(session, submap_id, cloud_points(place), pose(float(place)), 1_000 + place)


def first(watch, count):
    return list(itertools.islice(watch, count))


def until(watch, done):
    """The events up to the one that is `done`."""
    seen = []
    for event in watch:
        seen.append(event)
        if done(event):
            return seen
    raise AssertionError("the watch ended")


def is_loop(event):
    return event.kind == "LOOP_CLOSURE"


def test_a_watch_tells_of_operations_and_of_the_loop_that_they_find(client, session, town):
    watch = client.watch(town, after=0)
    for submap_id, place in (("a", 1), ("b", 30), ("c", 60), ("d", 1)):
        client.wait(post(client, session, submap_id, place))
    events = until(watch, is_loop)
    loop = events[-1].loop_closure
    assert (loop.query, loop.match, loop.state) == (
        f"{session.name}/submaps/d",
        f"{session.name}/submaps/a",
        "ACCEPTED",
    )
    numbers = [event.number for event in events]
    assert numbers == sorted(set(numbers))
    assert {event.operation.subject for event in events[:-1]} <= {f"{session.name}/submaps/{name}" for name in "abcd"}
    assert {event.map for event in events} == {town}
    assert watch.number == events[-1].number


def test_a_watch_begins_with_what_happens_from_now_on(client, session, town):
    client.wait(post(client, session, "before", 1))
    watch = client.watch(town)
    arrived = []
    reader = threading.Thread(target=lambda: arrived.extend(first(watch, 1)))
    reader.start()
    eventually(lambda: watch.number is not None, "the watch is not open")
    operation = client.wait(post(client, session, "after", 30))
    reader.join(PATIENCE_S)
    assert [event.operation.name for event in arrived] == [operation.name]


def test_kinds_keep_what_is_asked_for(client, session, town):
    for submap_id, place in (("a", 1), ("b", 30), ("c", 60), ("d", 1)):
        client.wait(post(client, session, submap_id, place))
    (event,) = first(client.watch(town, after=0, kinds=["LOOP_CLOSURE"]), 1)
    assert is_loop(event)


def test_other_maps_and_other_tenants_are_not_told(client, session, town):
    client.create_map(f"{town[5:]}-quiet")
    client.wait(post(client, session, "a", 1))
    quiet = client.create_session(f"{town}-quiet", "tuesday")
    operation = client.wait(post(client, quiet, "b", 1))
    events = until(client.watch(f"{town}-quiet", after=0), lambda event: event.operation.done)
    assert {event.operation.name for event in events} == {operation.name}
    with pytest.raises(NotFound):
        first(client.watch("maps/nowhere"), 1)


def test_a_search_that_somebody_waits_for_is_no_event(client, session, town):
    client.wait(post(client, session, "a", 1))
    client.search(town, points=cloud_points(1))
    client.wait(post(client, session, "b", 30))
    events = until(client.watch(town, after=0), lambda event: event.operation.subject.endswith("/b"))
    assert {event.operation.kind for event in events} == {"DESCRIBE_SUBMAP"}


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_cut_connections_lose_no_event_and_tell_none_twice(service, transport):
    """Every connection is cut after some bytes; the watch goes on behind what it had."""
    target = service.http.removeprefix("http://") if transport == "rest" else service.grpc
    budget = itertools.cycle([700, 2_500, 6_000, 1_500])
    with bad_link(target, lambda: Fault(cut_after=next(budget))) as link, Client(service.http, retry=SOON) as direct:
        made = (
            Client(f"http://{link.address}", retry=SOON)
            if transport == "rest"
            else Client.grpc(link.address, retry=SOON)
        )
        town = direct.create_map(f"cut-{transport}")
        session = direct.create_session(town, "monday")
        for number in range(24):
            direct.wait(post(direct, session, f"s{number}", 1 + 20 * (number % 4)))
        loops = [loop.name for loop in direct.loop_closures(town, state="ACCEPTED")]
        assert len(loops) > 20
        watch = made.watch(town, after=0, kinds=["LOOP_CLOSURE"])
        watch._retry = SOON
        told = [event.loop_closure.name for event in first(watch, len(loops))]
        assert told == loops
        assert link.cuts >= 3
        made.close()


def test_a_browser_goes_on_behind_the_id_that_it_saw_last(service, client, session, town):
    for submap_id, place in (("a", 1), ("b", 30)):
        client.wait(post(client, session, submap_id, place))
    (event,) = first(client.watch(town, after=0), 1)
    headers = {"last-event-id": str(event.number)}
    with httpx.stream("GET", f"{service.http}/v1/{town}/events?after=0", headers=headers, trust_env=False) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        lines = answer.iter_lines()
        received = [line for line in itertools.islice(lines, 9) if line]
    assert received[0] == "retry: 2000"
    assert received[1:3] == [f"id: {event.number}", "event: opened"]
    assert int(received[4].removeprefix("id: ")) > event.number


@pytest.mark.parametrize("query", ["after=-1", "after=9223372036854775808", "after=x", "kinds=EVERYTHING"])
def test_what_cannot_be_watched_is_refused(service, town, query):
    answer = httpx.get(f"{service.http}/v1/{town}/events?{query}", trust_env=False)
    assert (answer.status_code, answer.json()["reason"]) == (422, "BAD_FIELD")


def test_a_number_that_was_never_given_out_tells_that_the_database_is_another(client, session, town):
    (event,) = first(client.watch(town, after=2**62), 1)
    assert event.kind == "FORGOTTEN"


def test_what_is_forgotten_is_said_once(client, session, town, service):
    for number in range(4):
        client.wait(post(client, session, f"s{number}", 1 + 20 * number))
    forget = service.world.context.transactions.write(lambda uow: uow.events.forget(5))
    assert forget.result() > 0
    events = until(client.watch(town, after=0), lambda event: event.kind == "OPERATION")
    assert [event.kind for event in events[:-1]] == ["FORGOTTEN"]
    (event,) = first(client.watch(town, after=events[0].number), 1)
    assert event.kind == "OPERATION"


def test_a_silent_watch_gives_signs_of_life(monkeypatch):
    with live_service() as running:
        object.__setattr__(running.world.use_cases.events, "heartbeat_s", 0.3)
        with Client(running.http) as client:
            town = client.create_map("town")
        with httpx.stream("GET", f"{running.http}/v1/{town.name}/events", trust_env=False) as answer:
            assert any(line == ": alive" for line in answer.iter_lines())


def test_a_deleted_map_ends_the_watch_with_the_reason(client, session, town):
    watch = client.watch(town, after=0)
    client.wait(post(client, session, "a", 1))
    events = iter(watch)
    next(events)
    client.delete(town)
    other = client.create_session(client.create_map(f"{town[5:]}-next"), "monday")
    client.wait(post(client, other, "b", 1))
    with pytest.raises(NotFound):
        list(events)


def test_a_watch_needs_a_key_and_ends_when_the_key_is_revoked(guarded, monkeypatch):
    monkeypatch.setattr(access, "STREAM_RECHECK_S", 0.2)
    key = a_key(guarded.world, tenant="acme")
    with Client(guarded.http, api_key=key.text) as client:
        town = client.create_map("watched")
        watch = client.watch(town)
        failed = []

        def read():
            try:
                list(watch)
            except Unauthenticated as error:
                failed.append(error)

        reader = threading.Thread(target=read)
        reader.start()
        eventually(lambda: watch.number is not None, "the watch is not open")
        revoke = guarded.world.use_cases.keys.revoke(key.record.key_id)
        asyncio.run_coroutine_threadsafe(revoke, guarded.loop).result(PATIENCE_S)
        reader.join(PATIENCE_S)
        assert [error.reason for error in failed] == ["UNAUTHENTICATED"]
    answer = httpx.get(f"{guarded.http}/v1/maps/watched/events", trust_env=False)
    assert answer.status_code == 401


def test_watches_are_bounded_for_each_client(service, town):
    most = HttpLimits().calls.watches.holder
    opened = [httpx.Client(base_url=service.http, trust_env=False) for _ in range(most + 1)]
    try:
        held = [client.send(client.build_request("GET", f"/v1/{town}/events"), stream=True) for client in opened]
        assert [answer.status_code for answer in held] == [200] * most + [429]
        assert "retry-after" in held[-1].headers
        held[0].close()

        def let_in() -> bool:
            with opened[0].stream("GET", f"/v1/{town}/events") as answer:
                return answer.is_success

        eventually(let_in, "the place of a client that has gone was not given back")
    finally:
        for client in opened:
            client.close()


def test_a_watch_that_is_refused_for_now_is_tried_again(service, town, monkeypatch):
    with Client(service.http, retry=SOON) as client:
        refusals = iter([True, True, False])
        ask = client._transport.watch

        def sometimes(request):
            if next(refusals):
                raise ResourceExhausted(ErrorDetails("RESOURCE_EXHAUSTED", "RATE", "too many", retryable=True))
            return ask(request)

        monkeypatch.setattr(client._transport, "watch", sometimes)
        session = client.create_session(town, "tuesday")
        client.wait(post(client, session, "a", 1))
        watch = client.watch(town, after=0)
        watch._retry = SOON
        assert len(first(watch, 1)) == 1


def test_a_reader_that_does_not_read_is_cut_off(monkeypatch):
    """It holds one batch and what the kernel takes; then its connection is closed and its place is free."""
    lost, connection_lost = queue.SimpleQueue(), DeadlineProtocol.connection_lost

    def noted(protocol, *ends):
        lost.put(protocol.client)
        connection_lost(protocol, *ends)

    monkeypatch.setattr(DeadlineProtocol, "write_s", 0.3)
    monkeypatch.setattr(DeadlineProtocol, "connection_lost", noted)

    async def endless(self, tenant, map_id, after=None, kinds=frozenset()):
        while True:
            yield EventView(1, EventKind.OPENED, "x" * 10_000)
            await asyncio.sleep(0)  # where the end of the connection is noticed

    monkeypatch.setattr(Events, "watch", endless)
    with live_service() as running:
        host, _, port = running.http.removeprefix("http://").rpartition(":")
        with socket.create_connection((host, int(port))) as idle:
            idle.sendall(b"GET /v1/maps/town/events HTTP/1.1\r\nhost: localhost\r\n\r\n")
            while lost.get(timeout=PATIENCE_S) != idle.getsockname():  # others come and go while the service starts
                pass
            idle.settimeout(PATIENCE_S)
            received = 0
            while True:
                try:
                    part = idle.recv(1 << 20)
                except ConnectionResetError:
                    break
                if not part:
                    break
                received += len(part)
            assert received < 64 * 2**20


def test_the_data_of_an_event_is_the_json_of_its_message(service, client, session, town):
    client.wait(post(client, session, "a", 1))
    with httpx.stream("GET", f"{service.http}/v1/{town}/events?after=0", trust_env=False) as answer:
        told = (json.loads(line.removeprefix("data: ")) for line in answer.iter_lines() if line.startswith("data: "))
        event = next(event for event in told if event["kind"] == "OPERATION")
    assert set(event) == {"number", "kind", "map", "operation"}
    assert event["operation"]["state"] == "DONE"

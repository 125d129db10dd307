"""What is taken in: points a second, clouds at a time, streams at a time; for a client, a tenant and all."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack, ExitStack, suppress

import pytest

from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import (
    BESIDE_OTHERS,
    CALL_POINTS,
    CLOUD_POLL_S,
    CLOUD_POLLS,
    OTHERS_S,
    OVERLOAD_S,
    CapacityLimits,
)
from revisit.service.domain.errors import RateLimited, WorkersBusy


class Clock:
    """The time, and the client whose request is being answered."""

    now_s = 100.0
    client = "robot"

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def intake(clock, **limits):
    return InFlight(CapacityLimits(burst_s=2.0, **limits), lambda: clock.client, clock)


def wait_s(intake, tenant="anna"):
    try:
        intake.check_rate(tenant)
    except RateLimited as refused:
        return refused.retry_after_s
    return 0.0


def test_a_client_may_send_its_burst_and_then_its_rate(clock):
    bounded = intake(clock, client_points_per_s=5_000)
    bounded.charge_call("anna", 10_000 - CALL_POINTS)
    assert wait_s(bounded) == 0.0  # nothing is left, nothing is owed
    bounded.charge_call("anna", 5_000 - CALL_POINTS)
    assert wait_s(bounded) == pytest.approx(1.0)
    clock.now_s += 0.75
    assert wait_s(bounded) == pytest.approx(0.25)
    clock.now_s += 0.25
    assert wait_s(bounded) == 0.0


def test_whom_a_rate_limit_refuses_is_noted(clock):
    noted = []
    bounded = InFlight(
        CapacityLimits(burst_s=2.0, client_points_per_s=1_000),
        lambda: clock.client,
        clock,
        lambda tenant, client: noted.append((tenant, client)),
    )
    assert wait_s(bounded) == 0.0
    bounded.charge_call("anna", 2_000)
    assert wait_s(bounded) > 0.0
    assert noted == [("anna", clock.client)]


def test_what_was_saved_is_never_more_than_the_burst(clock):
    bounded = intake(clock, client_points_per_s=5_000)
    assert wait_s(bounded) == 0.0
    clock.now_s += 1_000_000.0
    bounded.charge_call("anna", 10_000)
    assert wait_s(bounded) == pytest.approx(CALL_POINTS / 5_000)


@pytest.mark.parametrize(
    ("limit", "same_client", "same_tenant", "other_tenant"),
    [
        ("client_points_per_s", True, False, False),
        ("tenant_points_per_s", True, True, False),
        ("points_per_s", True, True, True),
    ],
)
def test_a_debt_is_felt_by_those_who_share_the_bucket(clock, limit, same_client, same_tenant, other_tenant):
    bounded = intake(clock, **{limit: 1_000})
    bounded.charge_call("anna", 2_000)
    assert (wait_s(bounded) > 0.0) is same_client
    assert (wait_s(bounded, tenant="bert") > 0.0) is other_tenant
    clock.client = "other"
    assert (wait_s(bounded) > 0.0) is same_tenant


def test_a_call_without_points_costs_something(clock):
    bounded = intake(clock, client_points_per_s=CALL_POINTS)
    for _ in range(3):
        bounded.charge_call("anna", 0)
    assert wait_s(bounded) == pytest.approx(1.0)


async def test_a_cloud_is_paid_for_as_the_last_one_was_until_its_points_are_counted(clock):
    bounded = intake(clock, client_points_per_s=10_000)

    async def take(points):
        """The wait while a cloud is decoded, and after; None where it cannot be decoded."""
        async with bounded.reserve_cloud("anna") as decoded:
            meanwhile_s = wait_s(bounded)
            if points is not None:
                decoded(points)
            return meanwhile_s, wait_s(bounded)

    assert await take(19_000) == (0.0, 0.0)  # of the first one nothing is expected; the burst is used up
    clock.now_s += 0.1
    assert await take(4_000) == (pytest.approx(1.9), pytest.approx(0.4))
    clock.now_s += 0.5
    assert await take(None) == (pytest.approx(0.4), pytest.approx(0.4))
    assert wait_s(bounded) == pytest.approx(0.0)  # but for the call it is paid back


async def test_one_cloud_too_many_is_refused_until_one_is_done(clock):
    bounded = intake(clock, clouds=4, tenant_share=1.0)
    async with bounded.reserve_cloud("anna"), bounded.reserve_cloud("anna"), bounded.reserve_cloud("bert"):
        async with bounded.reserve_cloud("carl"):
            assert bounded.clouds == 4
            with pytest.raises(WorkersBusy):
                bounded.check_slot("dora")
            with pytest.raises(WorkersBusy) as refused:
                async with bounded.reserve_cloud("dora"):
                    pass
        assert refused.value.retry_after_s > 0
        clock.now_s += 1.1 * OVERLOAD_S
        async with bounded.reserve_cloud("dora"):
            assert bounded.clouds == 4
    assert bounded.clouds == 0


async def test_one_tenant_leaves_a_place_for_another(clock):
    bounded = intake(clock, clouds=4, tenant_share=0.75)
    async with bounded.reserve_cloud("anna"), bounded.reserve_cloud("anna"), bounded.reserve_cloud("anna"):
        with pytest.raises(WorkersBusy):
            async with bounded.reserve_cloud("anna"):
                pass
        async with bounded.reserve_cloud("bert"):
            assert bounded.clouds == 4


@pytest.mark.parametrize(
    ("sent_by_another_s_ago", "done_after", "waits"),
    [(None, None, 0), (1.1 * OTHERS_S, None, 0), (0.5 * OTHERS_S, 2, 2), (0.5 * OTHERS_S, None, CLOUD_POLLS)],
    ids=["alone", "the other has stopped", "until one is done", "but not for ever"],
)
async def test_beside_others_a_tenant_has_few_clouds_under_way(clock, sent_by_another_s_ago, done_after, waits):
    waited = []

    async def sleep(seconds):
        waited.append(seconds)
        if len(waited) == done_after:
            await places.aclose()

    bounded = InFlight(CapacityLimits(clouds=16), lambda: clock.client, clock, sleep=sleep)
    if sent_by_another_s_ago is not None:
        async with bounded.reserve_cloud("bert"):
            clock.now_s += sent_by_another_s_ago
    async with AsyncExitStack() as places:
        for _ in range(BESIDE_OTHERS):
            await places.enter_async_context(bounded.reserve_cloud("anna"))
        assert waited == []
        async with bounded.reserve_cloud("bert") if sent_by_another_s_ago == 0.5 * OTHERS_S else AsyncExitStack():
            pass
        async with bounded.reserve_cloud("anna"):
            assert waited == waits * [CLOUD_POLL_S]


async def test_others_wait_while_their_clouds_are_in_flight(clock):
    bounded = intake(clock)
    async with bounded.reserve_cloud("anna"):
        assert not bounded.others_wait("anna")
        assert bounded.others_wait("bert")


async def test_where_more_keeps_coming_the_line_of_the_tenant_is_short(clock, monkeypatch):
    monkeypatch.setattr("revisit.service.capacity.in_flight.DECODERS", 3)
    bounded = intake(clock, clouds=16, tenant_share=0.75)

    async def let_in(tenant, *, decode=False):
        """How many of 20 that come at once, each decoded at once or none of them."""
        async with AsyncExitStack() as places:
            for _ in range(20):
                with suppress(WorkersBusy):
                    decoded = await places.enter_async_context(bounded.reserve_cloud(tenant))
                    if decode:
                        decoded(1)
            return bounded.clouds

    assert await let_in("anna") == 12
    for _ in range(3):
        clock.now_s += 0.9 * OVERLOAD_S
        assert await let_in("anna") == 3
    assert await let_in("anna", decode=True) == 12  # what is decoded and being stored is not in line
    assert await let_in("anna") == 3
    assert await let_in("bert") == 12
    clock.now_s += 1.1 * OVERLOAD_S
    assert await let_in("anna") == 12


async def test_the_patient_wait_for_their_turn_in_order(clock):
    bounded = intake(clock, clouds=2, tenant_share=0.5)
    order = []

    async def take(name, tenant):
        async with bounded.reserve_cloud(tenant, patient=True):
            order.append(name)
            await asyncio.sleep(0)

    async with bounded.reserve_cloud("anna"):
        tasks = [asyncio.create_task(take(*who)) for who in (("a1", "anna"), ("a2", "anna"), ("b1", "bert"))]
        await asyncio.gather(tasks[2])
        assert order == ["b1"]  # bert need not wait behind anna's
    await asyncio.gather(*tasks)
    assert order == ["b1", "a1", "a2"]
    assert bounded.clouds == 0


async def test_the_patient_go_on_where_those_before_them_are_decoded(clock, monkeypatch):
    monkeypatch.setattr("revisit.service.capacity.in_flight.DECODERS", 1)
    bounded = intake(clock, clouds=4, tenant_share=1.0)
    bounded.note_overload("anna")
    entered = asyncio.Event()

    async def take():
        async with bounded.reserve_cloud("anna", patient=True):
            entered.set()

    async with bounded.reserve_cloud("anna") as decoded:
        waiting = asyncio.create_task(take())
        await asyncio.sleep(0)
        assert (bounded.clouds, entered.is_set()) == (1, False)
        decoded(1)
        await waiting
    assert entered.is_set() and bounded.clouds == 0


async def test_who_gives_up_waiting_takes_no_place(clock):
    bounded = intake(clock, clouds=1)

    async def take():
        async with bounded.reserve_cloud("anna", patient=True):
            pass

    async with bounded.reserve_cloud("anna"):
        waiting = [asyncio.create_task(take()) for _ in range(3)]
        await asyncio.sleep(0)
        waiting[0].cancel()
        await asyncio.gather(waiting[0], return_exceptions=True)
    waiting[1].cancel()  # given its place a moment ago
    await asyncio.gather(*waiting, return_exceptions=True)
    assert bounded.clouds == 0
    async with bounded.reserve_cloud("anna"):
        assert bounded.clouds == 1


def test_streams_are_bounded_for_a_client_and_for_all(clock):
    bounded = intake(clock, streams=5, client_streams=3)
    with ExitStack() as held:
        for _ in range(3):
            held.enter_context(bounded.reserve_stream("anna", replaces=False))
        with pytest.raises(RateLimited, match="3 streams of this client"):
            held.enter_context(bounded.reserve_stream("anna", replaces=False))
        # One that takes over from another, which ends, gets its place.
        with bounded.reserve_stream("anna", replaces=True):
            assert bounded.streams == 4
        held.enter_context(bounded.reserve_stream("bert", replaces=False))
        clock.client = "other"
        held.enter_context(bounded.reserve_stream("anna", replaces=False))
        with pytest.raises(RateLimited, match="5 in all"):
            held.enter_context(bounded.reserve_stream("anna", replaces=False))
    clock.client = "robot"
    assert bounded.streams == 0
    with bounded.reserve_stream("anna", replaces=False):
        assert bounded.streams == 1

"""Whoever begins too many calls waits, and nobody else does (P11)."""

from __future__ import annotations

import asyncio

import pytest

from revisit.service.capacity import limits
from revisit.service.capacity.call_pace import CallPace
from revisit.service.capacity.limits import PaceLimits
from revisit.service.domain.errors import RateLimited

LIMITS = PaceLimits(
    client_calls_per_s=10.0,
    tenant_calls_per_s=15.0,
    over_rate_calls_per_s=4.0,
    refusals_per_s=5.0,
    public_calls_per_s=5.0,
    burst=10,
    most_wait_s=2.0,
    waiting=25,
    unauthenticated_waiting=12,
)


class Time:
    """A clock, and sleepers who are woken when it has come so far."""

    def __init__(self):
        self.now_s, self.waits, self._sleepers = 0.0, [], []

    async def sleep(self, wait_s):
        self.waits.append(round(wait_s, 3))
        woken = asyncio.get_running_loop().create_future()
        self._sleepers.append((self.now_s + wait_s, woken))
        await woken

    async def pass_s(self, seconds):
        self.now_s += seconds
        for due_s, woken in self._sleepers:
            if due_s <= self.now_s and not woken.done():
                woken.set_result(None)
        await asyncio.sleep(0)


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def pace(time):
    return CallPace(LIMITS, lambda: time.now_s, time.sleep)


async def begun(calls):
    """Tasks of calls, each of which has come to where it waits, if it does."""
    tasks = [asyncio.create_task(call) for call in calls]
    await asyncio.sleep(0)
    return tasks


async def test_a_burst_waits_for_nothing_and_what_follows_comes_at_the_rate(pace, time):
    calls = await begun(pace.turn("acme", "robot") for _ in range(13))
    assert [call.done() for call in calls] == [True] * 10 + [False] * 3
    assert time.waits == [0.1, 0.2, 0.3]
    await time.pass_s(0.25)
    assert [call.done() for call in calls[10:]] == [True, True, False]
    await time.pass_s(0.1)
    await asyncio.gather(*calls)


async def test_others_do_not_wait_for_whoever_calls_too_often(pace, time):
    calls = await begun(pace.turn("acme", "robot") for _ in range(30))
    time.waits.clear()
    await pace.turn("another", "robot")
    calls += await begun([pace.turn("acme", "other")])
    assert time.waits == [1.4]  # the other key waits for its tenant: ten calls at once, then fifteen a second
    for call in calls:
        call.cancel()


async def test_a_client_has_so_many_calls_wait_and_one_more_is_told_when_to_come_back(pace, time):
    calls = await begun(pace.turn("acme", "robot") for _ in range(31))
    assert [call.done() for call in calls] == [True] * 10 + [False] * 20 + [True]
    with pytest.raises(RateLimited) as refused:
        calls[-1].result()
    assert refused.value.retry_after_s == pytest.approx(2.1)
    await time.pass_s(2.1)
    await pace.turn("acme", "robot")


async def test_all_callers_together_have_so_many_calls_wait_and_who_calls_seldom_is_served(pace):
    calls = await begun(pace.turn(tenant, "robot") for tenant in ("acme", "other") for _ in range(25))
    refused = [call for call in calls if call.done() and call.exception() is not None]
    assert len(refused) == 2 * 15 - LIMITS.waiting
    await pace.turn("third", "robot")
    for call in calls:
        call.cancel()


async def test_a_call_that_is_given_up_leaves_the_line(pace):
    calls = await begun(pace.turn("acme", "robot") for _ in range(30))
    for call in calls:
        call.cancel()
    await asyncio.gather(*calls, return_exceptions=True)
    assert pace.waiting == 0


async def test_a_call_that_is_given_up_has_spent_its_token(pace, time):
    calls = await begun(pace.turn("acme", "robot") for _ in range(20))
    for call in calls:
        call.cancel()
    await asyncio.gather(*calls, return_exceptions=True)
    time.waits.clear()
    (after,) = await begun([pace.turn("acme", "robot")])
    assert time.waits == [1.1]
    after.cancel()


async def test_calls_without_a_credential_come_at_the_pace_of_their_address(pace, time):
    calls = await begun(pace.public("10.0.0.9") for _ in range(21))
    assert [call.done() for call in calls] == [True] * 10 + [False] * 10 + [True]
    assert isinstance(calls[-1].exception(), RateLimited)
    time.waits.clear()
    await pace.public("10.0.0.10")
    assert not time.waits
    for call in calls:
        call.cancel()


async def test_strangers_that_wait_keep_no_caller_from_waiting(pace):
    unauthenticated = await begun(pace.public(f"10.0.0.{host}") for host in range(3) for _ in range(20))
    assert sum(not call.done() for call in unauthenticated) == LIMITS.unauthenticated_waiting
    calls = await begun(pace.turn("acme", "robot") for _ in range(30))
    assert sum(not call.done() for call in calls) == 20
    for call in (*unauthenticated, *calls):
        call.cancel()


async def test_strangers_of_one_address_are_refused_at_their_own_pace_and_at_once_where_too_many_wait(pace, time):
    told = await begun(pace.refusal("10.0.0.9") for _ in range(21))
    assert [call.done() for call in told] == [True] * 10 + [False] * 10 + [True]
    assert told[-1].exception() is None
    time.waits.clear()
    await pace.refusal("10.0.0.10")
    await pace.turn("acme", "robot")
    assert not time.waits
    for call in told:
        call.cancel()


@pytest.mark.parametrize("kind", ["public", "refusal"])
async def test_a_stranger_with_a_network_of_ipv6_addresses_has_the_pace_of_one(pace, time, kind):
    calls = await begun(getattr(pace, kind)(f"2001:db8::{host:x}") for host in range(11))
    assert [call.done() for call in calls] == [True] * 10 + [False]
    time.waits.clear()
    await getattr(pace, kind)("2001:db8:0:1::1")
    assert not time.waits
    for call in calls:
        call.cancel()


async def test_callers_that_have_not_called_for_long_are_forgotten(pace, monkeypatch):
    monkeypatch.setattr(pace._rates._buckets, "most", 20)
    for number in range(100):
        await pace.refusal(f"10.0.0.{number}")
    assert len(pace._rates._buckets) == 20


async def test_a_body_that_is_refused_unread_counts_as_the_calls_that_take_as_long(pace, time):
    await pace.turn("acme", "robot")
    pace.note_unread("acme", "robot", 10 * limits.UNREAD_BYTES_A_CALL)
    pace.note_unread("acme", "robot", 1)
    waiting = await begun([pace.turn("acme", "robot")])
    assert time.waits == [0.2]  # 11 calls before this one, of a burst of ten, ten a second
    await time.pass_s(100.0)
    await waiting[0]
    pace.note_unread("acme", "robot", 2**40)
    (after,) = await begun([pace.turn("acme", "robot")])
    assert time.waits[-1] == pytest.approx((1 + limits.MOST_CALLS_A_BODY - LIMITS.burst) / 10.0, abs=0.11)
    after.cancel()


async def test_whoever_was_refused_for_its_rate_comes_at_a_slower_pace_until_it_keeps_to_it(pace, time):
    pace.note_refused("acme", "robot")
    calls = await begun(pace.turn("acme", "robot") for _ in range(12))
    assert time.waits == [0.25, 0.5]  # ten at once, then four a second
    await pace.turn("another", "robot")
    await time.pass_s(limits.REFUSED_FOR_S)
    await asyncio.gather(*calls)
    await asyncio.gather(*(pace.turn("acme", "robot") for _ in range(8)))
    assert len(time.waits) == 2


@pytest.mark.parametrize("others_end_after", [0, 2, None])
async def test_whoever_was_refused_for_its_rate_lets_clouds_of_others_go_first_for_a_moment(others_end_after):
    waited = []

    async def sleep(seconds):
        waited.append(seconds)

    def others_wait(tenant):
        return tenant == "acme" and (others_end_after is None or len(waited) < others_end_after)

    pace = CallPace(LIMITS, lambda: 0.0, sleep, others_wait)
    await pace.turn("acme", "robot")
    assert waited == []
    pace.note_refused("acme", "robot")
    await pace.turn("acme", "other")
    assert waited == []
    await pace.turn("acme", "robot")
    assert waited == (limits.CALL_POLLS if others_end_after is None else others_end_after) * [limits.CALL_POLL_S]


async def test_those_that_were_refused_longest_ago_are_forgotten(pace, monkeypatch):
    monkeypatch.setattr(pace._refused_until_s, "most", 3)
    for number in range(5):
        pace.note_refused("acme", f"robot{number}")
    assert [client for _, _, client in pace._refused_until_s] == ["robot2", "robot3", "robot4"]

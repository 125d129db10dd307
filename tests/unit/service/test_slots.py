"""Slots are shared: whoever holds many leaves some to those that hold none (P11)."""

from __future__ import annotations

import asyncio

import pytest

from revisit.service.capacity.call_slots import CallSlots, waiting, watching
from revisit.service.capacity.limits import CallLimits, Share
from revisit.service.capacity.slots import Slots
from revisit.service.domain.errors import RateLimited

SHARE = Share("calls", 16, 12, 8)


def taken(slots, group, clients=4):
    """How many slots the clients of a group get, one after the other, until nothing more is to be had."""
    count = 0
    for client in (f"key{number}" for number in range(clients)):
        try:
            while True:
                slots.take(group, client)
                count += 1
        except RateLimited:
            continue
    return count


def test_a_client_and_a_tenant_have_their_bounds_where_nobody_else_holds_any():
    slots = Slots(SHARE)
    assert taken(slots, "acme", clients=1) == 8
    assert taken(slots, "acme") == 4


@pytest.mark.parametrize("greedy", [1, 2, 3])
def test_tenants_that_take_all_they_can_leave_a_slot_to_one_that_holds_none(greedy):
    slots = Slots(SHARE)
    for _ in range(5):
        for number in range(greedy):
            taken(slots, f"greedy{number}")
    assert taken(slots, "modest") >= 1


def test_slots_that_are_given_back_are_there_for_others():
    slots = Slots(SHARE)
    assert (taken(slots, "acme"), taken(slots, "other")) == (12, 2)
    for _ in range(8):
        slots.give("acme", "key0")
    assert taken(slots, "other") == 7  # nine in all: three quarters of the twelve that acme leaves
    assert slots.held == 13


def test_a_refusal_says_what_is_open_and_when_to_come_back():
    slots = Slots(SHARE)
    taken(slots, "acme", clients=1)
    with pytest.raises(RateLimited, match="8 calls of this client are open; close one first") as refused:
        slots.take("acme", "key0")
    assert refused.value.retry_after_s > 0


LIMITS = CallLimits(calls=Share("calls", 2, 2, 1), waits=Share("waits", 2, 2, 1), watches=Share("watches", 2, 2, 1))


async def test_a_call_that_waits_gives_its_slot_to_others_and_has_it_back_afterwards():
    slots = CallSlots(LIMITS)
    with slots.hold(slots.calls, "acme", "key"):
        with waiting():
            assert (slots.calls.held, slots.waits.held) == (0, 1)
            with pytest.raises(RateLimited, match="waits"), slots.hold(slots.calls, "acme", "key"), waiting():
                pass
            slots.calls.take("acme", "key")
        assert (slots.calls.held, slots.waits.held) == (2, 0)
        with watching():
            assert (slots.calls.held, slots.watches.held) == (1, 1)
    assert (slots.calls.held, slots.watches.held) == (1, 0)


async def test_a_wait_knows_when_its_client_has_left_and_looks_no_longer_than_it_waits():
    slots, left, looks = CallSlots(LIMITS), asyncio.Event(), []

    async def gone():
        looks.append("began")
        try:
            await left.wait()
        finally:
            looks.append("ended")

    with slots.hold(slots.calls, "acme", "key", gone):
        with waiting() as wait:
            await asyncio.sleep(0)
            assert not wait.abandoned
        await asyncio.sleep(0)
        assert looks == ["began", "ended"]
        with waiting() as wait:
            left.set()
            while not wait.abandoned:
                await asyncio.sleep(0)


async def test_a_use_case_without_a_transport_waits_as_it_likes():
    with waiting() as wait:
        assert not wait.abandoned

"""Bytes in flight: those that wait for room, and the share of a tenant."""

from __future__ import annotations

import asyncio

import pytest

from revisit.service.capacity.byte_budget import ByteBudget
from revisit.service.domain.errors import WorkersBusy


async def held(budget, tenant, count, may_leave):
    with budget.hold(tenant) as share:
        await share.wait_for(count)
        await may_leave.wait()


async def begun(calls):
    tasks = [asyncio.create_task(call) for call in calls]
    await asyncio.sleep(0)
    return tasks


async def test_the_first_that_fits_goes_on_when_bytes_are_given_back():
    budget, may_leave = ByteBudget(100), asyncio.Event()
    with budget.hold("anna") as own:
        own.set(70)
        tasks = await begun([held(budget, "bert", 60, may_leave), held(budget, "carl", 40, may_leave)])
        assert budget.held_bytes == 70
        own.set(50)
        assert budget.held_bytes == 90  # the smaller one, though it came later
    assert budget.held_bytes == 100
    may_leave.set()
    await asyncio.gather(*tasks)
    assert budget.held_bytes == 0


async def test_one_that_waits_too_long_is_refused_and_holds_nothing():
    budget, may_leave = ByteBudget(100, patience_s=0.0), asyncio.Event()
    with budget.hold("anna") as own:
        own.set(70)
        with pytest.raises(WorkersBusy):
            await held(budget, "bert", 40, may_leave)
        assert budget.held_bytes == 70
    assert budget.held_bytes == 0


async def test_one_that_is_cancelled_just_when_there_is_room_holds_nothing():
    budget, may_leave = ByteBudget(100), asyncio.Event()
    with budget.hold("anna") as own:
        own.set(70)
        (waiting,) = await begun([held(budget, "bert", 60, may_leave)])
    assert budget.held_bytes == 60
    waiting.cancel()
    await asyncio.wait([waiting])
    assert budget.held_bytes == 0

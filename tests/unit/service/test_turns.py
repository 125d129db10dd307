"""Turns are shared between tenants, whatever one of them asks for."""

from __future__ import annotations

import asyncio
import contextlib

import pytest

from revisit.service.capacity.in_flight import Turns


@pytest.fixture
def order():
    return []


async def work(turns, tenant, order, steps=1):
    async with turns.of(tenant):
        order.append(tenant)
        for _ in range(steps):
            await asyncio.sleep(0)


async def test_tenants_take_turns_and_each_keeps_its_own_order(order):
    turns = Turns(1)
    tasks = [asyncio.create_task(work(turns, tenant, order)) for tenant in ("anna",) * 5 + ("bert",) * 2 + ("carl",)]
    await asyncio.gather(*tasks)
    assert order == ["anna", "anna", "bert", "carl", "anna", "bert", "anna", "anna"]


async def test_a_tenant_has_no_more_places_than_it_may(order):
    turns = Turns(3, of_tenant=1)
    async with turns.of("anna"):
        waiting = asyncio.create_task(work(turns, "anna", order))
        await work(turns, "bert", order)
        await asyncio.sleep(0)
        assert order == ["bert"]
    await waiting
    assert order == ["bert", "anna"]


async def test_whoever_goes_away_leaves_no_place_taken(order):
    turns = Turns(1)
    async with turns.of("anna"):
        waiting = [asyncio.create_task(work(turns, tenant, order)) for tenant in ("anna", "bert", "bert")]
        await asyncio.sleep(0)
        waiting[1].cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await waiting[1]
    # This one has its turn already, and has not begun.
    waiting[0].cancel()
    await asyncio.wait(waiting)
    assert order == ["bert"]
    await work(turns, "carl", order)
    assert order == ["bert", "carl"]


async def test_whoever_is_cancelled_just_when_a_place_is_free_leaves_it_to_the_next(order):
    turns = Turns(1)
    async with turns.of("anna"):
        waiting = [asyncio.create_task(work(turns, tenant, order)) for tenant in ("bert", "carl")]
        await asyncio.sleep(0)
        waiting[0].cancel()
    await asyncio.wait(waiting)
    assert order == ["carl"] and waiting[0].cancelled()

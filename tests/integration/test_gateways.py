"""Several gateways of one store: one keeps it, and each has its part of what a tenant may have of all."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from revisit.core.errors import RevisitError
from revisit.service.capacity.budget import GatewayShare
from revisit.service.capacity.call_pace import CallPace
from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import CALL_POINTS, CapacityLimits, PaceLimits
from revisit.service.domain.identity import TenantId
from revisit.service.features.upkeep.gateways import KEEPS_FOR_S, Gateways
from revisit.service.ports.processes import GONE_AFTER_MS
from tests.support.service_world import TENANT, memory_world


@pytest.fixture
def world():
    return memory_world()


def gateway(world):
    share = GatewayShare()
    return Gateways(world.context.storage, share, lambda: world.clock.ms / 1000), share


async def shown(world, *gateways):
    """Each shows itself, a millisecond after the other."""
    for one in gateways:
        world.clock.ms += 1
        await one.show()


async def test_a_gateway_alone_keeps_the_store_and_has_all_of_each_limit(world):
    alone, share = gateway(world)
    await shown(world, alone)
    assert not alone.keeps
    await shown(world, alone)
    assert alone.keeps and share.gateways == 1


async def test_the_gateway_that_came_first_keeps_the_store_and_the_next_one_once_it_is_gone(world):
    made = [gateway(world) for _ in range(3)]
    gateways = [one for one, _ in made]
    for _ in range(2):
        await shown(world, *gateways)
        assert sum(one.keeps for one in gateways) <= 1
    assert [one.keeps for one in gateways] == [True, False, False]
    assert {share.gateways for _, share in made} == {3}
    await gateways[0].leave()
    for _ in range(2):
        await shown(world, *gateways[1:])
    assert [one.keeps for one in gateways] == [False, True, False]
    assert {share.gateways for _, share in made[1:]} == {2}


async def test_no_two_gateways_keep_the_store_while_one_stands_still_and_when_it_goes_on(world):
    (first, _), (second, _) = gateway(world), gateway(world)
    for _ in range(2):
        await shown(world, first, second)
    assert first.keeps
    for _ in range(12):
        assert not (first.keeps and second.keeps)
        world.clock.ms += 1000
        await second.show()
    assert second.keeps and not first.keeps
    for _ in range(3):
        await shown(world, first)
        assert second.keeps and not first.keeps
        await shown(world, second)
    assert GONE_AFTER_MS / 1000 > KEEPS_FOR_S


async def test_only_the_keeper_does_the_chores_of_all(world):
    done = []

    async def chore():
        done.append(True)

    gateways = [gateway(world)[0] for _ in range(2)]
    for _ in range(2):
        await shown(world, *gateways)
    for one in gateways:
        await one.of_keeper(chore)()
    assert done == [True]


def accepted_points(share, seconds=40):
    """Points that a client gets through within so many seconds, where it asks for all that it may."""
    now_s, accepted = [0.0], 0
    limits = CapacityLimits(points_per_s=1e9, tenant_points_per_s=1e9, client_points_per_s=1000.0)
    counter = InFlight(limits, lambda: "robot", lambda: now_s[0], share=share)
    while now_s[0] < seconds:
        try:
            counter.check_rate(TENANT)
            counter.charge_call(TENANT, 100 - CALL_POINTS)
            accepted += 100
        except RevisitError:
            now_s[0] += 0.1
    return accepted


def test_a_client_gets_a_part_of_its_rate_at_each_of_several_gateways():
    alone, third = GatewayShare(), GatewayShare()
    third.gateways = 3
    assert accepted_points(third) == pytest.approx(accepted_points(alone) / 3, rel=0.1)


def test_a_client_has_a_part_of_its_streams_at_each_gateway_and_one_at_least():
    for gateways, most in ((1, 8), (3, 3), (20, 1)):
        share = GatewayShare()
        share.gateways = gateways
        counter = InFlight(client=lambda: "robot", share=share)
        with ExitStack() as streams:
            for _ in range(most):
                streams.enter_context(counter.reserve_stream(TENANT, replaces=False))
            with pytest.raises(RevisitError), counter.reserve_stream(TENANT, replaces=False):
                pass


async def test_calls_begin_at_a_third_of_the_pace_once_there_are_three_gateways():
    waited = []

    async def sleep(seconds):
        waited.append(seconds)

    share = GatewayShare()
    pace = CallPace(
        PaceLimits(client_calls_per_s=30.0, tenant_calls_per_s=1e6, burst=1), lambda: 0.0, sleep, share=share
    )
    await pace.turn(TenantId("acme"), "robot")
    await pace.turn(TenantId("acme"), "robot")
    share.gateways = 3
    await pace.turn(TenantId("acme"), "robot")
    assert waited == pytest.approx([1 / 30, 2 / 10])

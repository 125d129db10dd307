"""Drives in one map share a frame where their surfaces agree. Streets are simulated, the method is the real one."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.domain.identity import SessionKey
from tests.support.block_worlds import STEP_M, along, seen, twin_streets
from tests.support.driven_maps import driven_on, opened, random_start, real_world
from tests.support.service_world import TENANT

pytestmark = pytest.mark.slow

SAME_M = 90.0
"""So far both streets are the same."""

LENGTH_M = 170.0
TWIN_M = 400.0
"""Where the other street lies, along y."""


@pytest.fixture(scope="module")
def recogniser():
    return load_recogniser()


@pytest.fixture(scope="module")
def town():
    return twin_streets(21, SAME_M, apart_m=TWIN_M)


def street(y: float) -> list[np.ndarray]:
    return along((0.0, y), (LENGTH_M, y))


async def optimised(world, recogniser):
    posted = await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off(recogniser)
    return (await world.use_cases.operations.get(TENANT, posted.operation.operation_id)).result


async def test_a_drive_on_the_street_of_another_day_joins_it(town, recogniser):
    world, rng = real_world(), np.random.default_rng(3)
    for day, y in (("monday", 0.0), ("tuesday", 1.0)):
        key = SessionKey("town", day)
        await opened(world, key)
        await driven_on(world, key, seen(town, street(y), seed=int(y)), random_start(rng), recogniser)
    version = await optimised(world, recogniser)
    assert (version["frames"], version.get("refused_joins")) == (1, None)
    assert version["loops_in_map"] > 100


async def test_a_drive_that_leaves_the_other_street_behind_loses_its_frame(town, recogniser):
    world, rng = real_world(), np.random.default_rng(4)
    monday, tuesday = SessionKey("town", "monday"), SessionKey("town", "tuesday")
    await opened(world, monday)
    await driven_on(world, monday, seen(town, street(0.0), seed=0), random_start(rng), recogniser)
    await opened(world, tuesday)
    start, scans = random_start(rng), list(seen(town, street(TWIN_M + 1.0), seed=1))
    same = int(0.6 * SAME_M / STEP_M)
    await driven_on(world, tuesday, scans[:same], start, recogniser)
    assert (await optimised(world, recogniser))["frames"] == 1  # nothing that was seen so far tells them apart
    await driven_on(world, tuesday, scans[same:], start, recogniser, after=same)
    version = await optimised(world, recogniser)
    print(version)
    (refused,) = version["refused_joins"]
    assert (version["frames"], version["loops_in_map"]) == (2, 0)
    assert refused["reason"] == "FREE_SPACE_VIOLATED" and refused["loops"] == version["loops_set_aside"] > 50
    assert {*refused["sessions"], *refused["other_sessions"]} == {monday.name, tuesday.name}
    assert (await optimised(world, recogniser))["refused_joins"] == [refused]

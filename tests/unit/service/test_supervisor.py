"""The watch over the workers goes on whatever the operating system says."""

from __future__ import annotations

import asyncio

import pytest

from revisit.service.worker import supervisor
from revisit.service.worker.supervisor import WorkerSupervisor
from tests.support.patience import PATIENCE_S
from tests.support.service_world import memory_world


class EndedProcess:
    """A worker that ends by itself at the instant when it is told to."""

    pid = 4_000_000

    def __init__(self):
        self.ended = asyncio.Event()

    def send_signal(self, number):
        self.ended.set()
        raise ProcessLookupError

    async def wait(self):
        await self.ended.wait()
        return 0


@pytest.fixture
def world(monkeypatch):
    monkeypatch.setattr(supervisor, "RESPAWN_S", (0.001, 0.002))
    made = memory_world()
    yield made
    made.context.transactions.close()


async def test_a_worker_that_cannot_be_started_is_tried_again_and_one_that_has_ended_does_not_spoil_the_stop(
    world, monkeypatch
):
    attempts, started = [], asyncio.Event()

    async def start(*_command, **_options):
        attempts.append(1)
        if len(attempts) < 3:
            raise BlockingIOError(11, "Resource temporarily unavailable")
        started.set()
        return EndedProcess()

    monkeypatch.setattr(asyncio, "create_subprocess_exec", start)
    watch = WorkerSupervisor(world.context.storage, world.context.policy.lease_ms, 1, "one")
    watch.start()
    await asyncio.wait_for(started.wait(), PATIENCE_S)
    await asyncio.wait_for(watch.stop(5.0), PATIENCE_S)
    assert len(attempts) == 3

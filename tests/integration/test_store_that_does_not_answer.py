"""A store that does not answer while a job runs makes no dead letter of the job (P14)."""

from __future__ import annotations

import pytest

from revisit.service.domain.errors import StorageFull, StorageUncertain
from tests.support.service_world import TENANT, memory_world, posted


@pytest.mark.parametrize("error", [StorageUncertain("another process holds the database"), StorageFull()])
async def test_a_submap_whose_store_does_not_answer_is_described_once_it_does(monkeypatch, error):
    world, refused = memory_world(), 0
    await posted(world, a=1)
    put = world.context.blobs.put

    def put_or_refuse(tenant, kind, data):
        nonlocal refused
        if refused < 6:
            refused += 1
            raise error
        return put(tenant, kind, data)

    monkeypatch.setattr(world.context.blobs, "put", put_or_refuse)
    for _ in range(8):
        world.work_off()
        world.clock.ms += 60_000
    (stored,) = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    assert (stored.state, refused) == ("DESCRIBED", 6)

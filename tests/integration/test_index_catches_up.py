"""A fresh index catches up with the database in portions and then knows what one that saw everything knows."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.service.features.index import caught_up_index
from tests.support.memory.vector_index import MemoryVectorIndex
from tests.support.own_index import memory_over
from tests.support.records import anywhere
from tests.support.service_world import TENANT, open_session, sqlite_world, submap


@pytest.mark.parametrize("portion", [1, 2, 5, 6, 100])
async def test_portions_of_any_size_give_the_same_index(tmp_path, monkeypatch, portion):
    world = sqlite_world(tmp_path)
    await open_session(world)
    for number in range(5):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", number))
    world.work_off()
    await world.use_cases.submaps.delete(TENANT, submap("s3", 3).key)  # the sixth change
    monkeypatch.setattr(caught_up_index, "PORTION", portion)
    index = MemoryVectorIndex()
    memory = memory_over(world.context.transactions, index)

    def load(uow):
        return uow.maps.get(TENANT, "town"), uow.submaps.get(TENANT, "town", "monday", "s1")

    map_record, record = world.context.transactions.read(load).result()
    recall = memory.recall(map_record, np.frombuffer(record.descriptor, dtype="<f4"), 10, anywhere)
    assert {place.submap.submap_id for place in recall.places} == {"s0", "s1", "s2", "s4"}
    assert recall.places[0].submap.submap_id == "s1"
    assert (index.size(map_record.number), index.seq(map_record.number)) == (4, 6)
    world.context.transactions.close()

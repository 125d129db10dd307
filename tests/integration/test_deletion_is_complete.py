"""What is deleted is gone from the disk after two hours, byte for byte, once the log of the database is folded back."""

from __future__ import annotations

from pathlib import Path

import pytest

from revisit.service.features.deletion.blob_references import blobs_of_submap
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect
from tests.support.service_world import SESSION, TENANT, described, sqlite_world, submap


def holds(home: Path, needle: bytes) -> bool:
    """Whether any file of the data folder has these bytes."""
    return any(needle in path.read_bytes() for path in home.rglob("*") if path.is_file())


def traces(world, submap_id: str) -> list[bytes]:
    """What is stored of a submap: its descriptor, the hash of its cloud and the content of each blob."""

    def load(uow):
        return uow.submaps.get(TENANT, SESSION.map_id, SESSION.session_id, submap_id)

    record = world.context.transactions.read(load).result()
    blobs = [world.context.blobs.get(TENANT, *address) for address in blobs_of_submap(record)]
    return [record.descriptor, record.cloud_sha256.encode(), *blobs]


@pytest.mark.parametrize("what", ["submap", "session", "map"])
async def test_no_byte_of_what_was_deleted_is_left(tmp_path, what):
    world = sqlite_world(tmp_path)
    await described(world, secret=1, kept=2)
    secret, kept = traces(world, "secret"), traces(world, "kept")
    assert len(secret) == 5
    assert all(holds(tmp_path, trace) for trace in [*secret, *kept])
    if what == "submap":
        await world.use_cases.submaps.delete(TENANT, submap("secret", 1).key)
    elif what == "session":
        await world.use_cases.sessions.delete(TENANT, SESSION)
    else:
        await world.use_cases.maps.delete(TENANT, SESSION.map_id)
    for gone in (3, 0):  # the bytes first, an hour later their hashes
        world.clock.ms += int(UNREFERENCED_S * 1000)
        assert await collect(world.context.storage) == gone * (1 if what == "submap" else 2)
    world.context.transactions.close()
    assert [holds(tmp_path, trace) for trace in secret] == [False] * 5
    assert [holds(tmp_path, trace) for trace in kept] == [what == "submap"] * 5
    assert holds(tmp_path, f"{what}_deleted".encode()), "the audit log does not tell of it"

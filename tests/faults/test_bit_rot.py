"""One flipped bit in any stored file: it is noticed, never served, and harms nothing but its own submap (P28)."""

from __future__ import annotations

import asyncio
import random
from contextlib import closing
from pathlib import Path

import pytest

from revisit.core.errors import DataLoss
from revisit.service.domain.identity import SubmapKey
from revisit.service.engines.local.files.blobs import FileBlobStore, blob_path
from revisit.service.engines.local.sqlite.blob_rows import named_blobs
from revisit.service.engines.local.sqlite.connections import DATABASE, open_to_read
from revisit.service.engines.local.sqlite.examination import examine
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.deletion.blob_references import blobs_of_submap
from revisit.service.ports.blobs import CLOUD_BLOB, MAP_LAYOUT_BLOB, NEURAL_MAP_BLOB, PLACE_BLOB, PLAN_BLOB, TILE_BLOB
from tests.faults.drive import undisturbed
from tests.support.campaigns import Campaign, sizes
from tests.support.service_world import SESSION, TENANT, World, open_session, sqlite_world, submap
from tests.support.state import of_sqlite

SERVED_AS = {CLOUD_BLOB: DownloadKind.POINTS, NEURAL_MAP_BLOB: DownloadKind.NEURAL}
"""What a client asks for to be given a stored file; the places are for the workers alone."""

SUBMAPS = ("a", "b", "c")


@pytest.fixture
def world(folder):
    made = sqlite_world(folder / "home")
    asyncio.run(_fill(made))
    yield made
    made.context.transactions.close()


async def _fill(world: World) -> None:
    await open_session(world)
    for place, submap_id in enumerate(SUBMAPS, start=1):
        await world.use_cases.posting.post(TENANT, submap(submap_id, place))
    world.work_off()


def key(submap_id: str) -> SubmapKey:
    return SubmapKey(SESSION.map_id, SESSION.session_id, submap_id)


def download(world: World, submap_id: str, kind: DownloadKind) -> bytes:
    return asyncio.run(world.use_cases.submaps.download(TENANT, key(submap_id), kind)).data


def stored_files(world: World, home: Path) -> list[tuple[Path, str, str]]:
    """Every file with the submap it belongs to and its kind."""
    records = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    named = {sha256: (record.submap_id, kind) for record in records for kind, sha256 in blobs_of_submap(record)}
    files = sorted(path for path in (home / "blobs").rglob("*") if path.is_file())
    return [(path, *named[path.name]) for path in files]


def flipped(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


@of_sqlite("what rows of a server name is examined in test_postgres_examination")
def test_a_flipped_bit_of_any_kind_of_blob_is_noticed_and_the_others_are_whole(tmp_path):
    (tmp_path / "home").mkdir()
    undisturbed(tmp_path / "home", tmp_path / "log")
    rng, kinds = random.Random(29), {CLOUD_BLOB, PLACE_BLOB, NEURAL_MAP_BLOB, TILE_BLOB, MAP_LAYOUT_BLOB, PLAN_BLOB}
    with closing(open_to_read(tmp_path / "home" / DATABASE)) as rows:
        named = list(named_blobs(rows))
    assert {blob.kind for blob in named} == kinds
    for blob in named:
        path = blob_path(tmp_path / "home/blobs", blob)
        sound = path.read_bytes()
        path.write_bytes(flipped(sound, rng))
        wrong = [one.detail for one in examine(tmp_path / "home", full=True) if one.ok is False]
        assert len(wrong) == 1 and blob.sha256[:12] in wrong[0], (blob, wrong)
        path.write_bytes(sound)


@pytest.mark.parametrize("flips", sizes("BIT_FLIPS", 30, 1_000))
@pytest.mark.timeout(3600)
def test_a_flipped_bit_is_noticed_and_harms_its_own_submap_only(world, folder, flips):
    rng, blobs = random.Random(28), FileBlobStore(folder / "home/blobs")
    files = stored_files(world, folder / "home")
    assert len(files) == 3 * len(SUBMAPS)
    campaign = Campaign("P28", flips)
    for number in campaign:
        path, submap_id, kind = files[number % len(files)]
        sound = path.read_bytes()
        path.write_bytes(flipped(sound, rng))
        if kind in SERVED_AS:
            with pytest.raises(DataLoss):
                download(world, submap_id, SERVED_AS[kind])
        else:
            with pytest.raises(DataLoss):
                blobs.get(TENANT, kind, path.name)
        assert not path.exists()  # put aside
        other = SUBMAPS[SUBMAPS.index(submap_id) - 1]
        assert download(world, other, DownloadKind.POINTS)
        path.write_bytes(sound)
    assert blobs.quarantined() > 0
    campaign.publish(f"{campaign.done} of {campaign.done} flipped bits noticed, 0 damaged files served")

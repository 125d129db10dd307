"""Backup, restore, scrub and doctor over a real data folder."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
import sqlite3
import stat
import threading
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.core.errors import DataLoss
from revisit.service.engines.local.files.secret_files import keep_secret, read_secret
from revisit.service.engines.local.sqlite import backup
from revisit.service.engines.local.sqlite.backup import BackupRefused, make_backup, restore_backup
from revisit.service.engines.local.sqlite.backup_key import KEY_FILE, own_key
from revisit.service.engines.local.sqlite.examination import examine, scrub
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect
from revisit.service.ports.blobs import PLACE_BLOB
from tests.support.patience import PATIENCE_S
from tests.support.service_world import TENANT, answered, open_session, sqlite_world, submap


@pytest.fixture
def home(tmp_path):
    return tmp_path / "home"


@pytest.fixture
async def world(home):
    """Four described submaps in one session, each with a cloud, place and neural map."""
    opened = sqlite_world(home)
    await open_session(opened)
    for number in range(4):
        await opened.use_cases.posting.post(TENANT, submap(f"s{number}", number))
    opened.work_off()
    yield opened
    opened.context.transactions.close()


@pytest.fixture
def archive(world, home, tmp_path):
    make_backup(home, tmp_path / "backup", "1.0")
    return tmp_path / "backup"


def blobs(folder: Path) -> dict[str, bytes]:
    files = (path for path in (folder / "blobs").rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def names(home: Path) -> set[str]:
    restored = sqlite_world(home)
    found = restored.context.transactions.read(lambda uow: uow.submaps.find(TENANT, map_id="town")).result()
    restored.context.transactions.close()
    return {record.submap_id for record in found}


def flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


def healthy(home: Path) -> bool:
    return all(finding.ok is not False for finding in examine(home, full=True))


async def test_a_restored_backup_is_what_was_backed_up(world, home, archive, tmp_path):
    manifest = restore_backup(archive, tmp_path / "restored", own_key(home))
    assert (manifest.blobs, manifest.lost) == (12, ())
    assert blobs(tmp_path / "restored") == blobs(home)
    assert names(tmp_path / "restored") == {"s0", "s1", "s2", "s3"}
    assert healthy(tmp_path / "restored")
    restored = sqlite_world(tmp_path / "restored")
    mesh = await answered(restored, restored.use_cases.submaps.download(TENANT, submap("s1", 1).key, DownloadKind.MESH))
    assert mesh.data.startswith(b"ply\n")
    assert (await restored.use_cases.posting.post(TENANT, submap("s1", 1))).replay
    restored.context.transactions.close()


async def test_a_backup_under_ingest_has_everything_that_was_acknowledged_before_it_began(world, home, tmp_path):
    acknowledged, stop = [], threading.Event()

    async def ingest():
        number = 100
        while not stop.is_set():
            await world.use_cases.posting.post(TENANT, submap(f"s{number}", number))
            acknowledged.append(f"s{number}")
            number += 1

    ingesting = asyncio.create_task(ingest())
    while len(acknowledged) < 5:
        await asyncio.sleep(0.01)
    before = {"s0", "s1", "s2", "s3", *acknowledged}
    manifest = await asyncio.to_thread(make_backup, home, tmp_path / "backup", "1.0")
    stop.set()
    await ingesting
    restore_backup(tmp_path / "backup", tmp_path / "restored", own_key(home))
    assert manifest.lost == ()
    assert before <= names(tmp_path / "restored") <= {*before, *acknowledged}
    assert healthy(tmp_path / "restored")


async def test_what_is_deleted_during_a_backup_is_whole_in_it_and_is_swept_later(world, home, tmp_path, monkeypatch):
    real, loop = backup._copy_blobs, asyncio.get_running_loop()

    async def delete(submap_id):
        await world.use_cases.submaps.delete(TENANT, submap(submap_id, 0).key)
        world.clock.ms += int(UNREFERENCED_S * 1000)
        assert await collect(world.context.storage) == 3

    def delete_first(*arguments):
        asyncio.run_coroutine_threadsafe(delete("s0"), loop).result(PATIENCE_S)
        return real(*arguments)

    monkeypatch.setattr(backup, "_copy_blobs", delete_first)
    manifest = await asyncio.to_thread(make_backup, home, tmp_path / "backup", "1.0")
    monkeypatch.undo()
    assert manifest.lost == ()
    restore_backup(tmp_path / "backup", tmp_path / "restored", own_key(home))
    assert names(tmp_path / "restored") == {"s0", "s1", "s2", "s3"}
    assert names(home) == {"s1", "s2", "s3"} and len(blobs(home)) == 12, "its blobs wait for the sweep"
    await delete("s1")
    assert len(blobs(home)) == 9


def damage_database(archive: Path) -> None:
    flip_a_bit(archive / "revisit.db")


def damage_a_blob(archive: Path) -> None:
    flip_a_bit(archive / sorted(blobs(archive))[0])


def lose_a_blob(archive: Path) -> None:
    (archive / sorted(blobs(archive))[-1]).unlink()


def lose_the_manifest(archive: Path) -> None:
    (archive / "manifest.json").unlink()


def cut_the_manifest(archive: Path) -> None:
    (archive / "manifest.json").write_bytes((archive / "manifest.json").read_bytes()[:-20])


def of_the_future(archive: Path) -> None:
    rewrite(archive, revision="9999")


def of_another_format(archive: Path) -> None:
    rewrite(archive, format=3)


def rewrite(archive: Path, **changes) -> None:
    manifest = json.loads((archive / "manifest.json").read_text())
    (archive / "manifest.json").write_text(json.dumps({**manifest, **changes}))


@pytest.mark.parametrize(
    "damage",
    [
        damage_database,
        damage_a_blob,
        lose_a_blob,
        lose_the_manifest,
        cut_the_manifest,
        of_the_future,
        of_another_format,
    ],
)
async def test_a_damaged_or_foreign_backup_is_refused_and_leaves_nothing(archive, home, tmp_path, damage):
    damage(archive)
    kept = blobs(archive)
    with pytest.raises(BackupRefused):
        restore_backup(archive, tmp_path / "restored", own_key(home))
    assert not (tmp_path / "restored").exists() and not (tmp_path / "restored.restoring").exists()
    assert blobs(archive) == kept, "the backup itself is not touched"


async def test_nothing_is_overwritten(world, home, archive, tmp_path):
    with pytest.raises(FileExistsError, match="new folder"):
        make_backup(home, archive, "1.0")
    with pytest.raises(FileExistsError, match="not empty"):
        restore_backup(archive, home, own_key(home))
    with pytest.raises(FileNotFoundError, match="no database"):
        make_backup(tmp_path / "nowhere", tmp_path / "other", "1.0")
    (tmp_path / "empty").mkdir()
    restore_backup(archive, tmp_path / "empty", own_key(home))
    assert healthy(tmp_path / "empty")


async def test_a_backup_says_what_was_lost_before_it_and_can_still_be_restored(world, home, tmp_path):
    victim = sorted(blobs(home))[0]
    flip_a_bit(home / victim)
    manifest = make_backup(home, tmp_path / "backup", "1.0")
    assert len(manifest.lost) == 1 and manifest.lost[0].endswith(Path(victim).name) and manifest.blobs == 11
    restore_backup(tmp_path / "backup", tmp_path / "restored", own_key(home))
    assert len(blobs(tmp_path / "restored")) == 11
    assert not healthy(tmp_path / "restored")


@pytest.mark.parametrize("kind", ["cloud", PLACE_BLOB, "neural-map"])
async def test_a_flipped_bit_is_found_moved_aside_and_hurts_one_item_only(world, home, kind):
    victim = next(home / name for name in sorted(blobs(home)) if f"/{kind}/" in name)
    flip_a_bit(victim)
    assert not healthy(home) and victim.exists(), "doctor changes nothing"
    found = scrub(home)
    assert (found.checked, len(found.damaged), found.missing, found.database) == (12, 1, (), "ok")
    assert not victim.exists() and len(list((home / "blobs" / ".quarantine").iterdir())) == 1
    downloads = {"cloud": DownloadKind.POINTS, "neural-map": DownloadKind.NEURAL}
    if kind in downloads:
        lost = 0
        for number in range(4):
            try:
                await world.use_cases.submaps.download(TENANT, submap(f"s{number}", number).key, downloads[kind])
            except DataLoss:
                lost += 1
        assert lost == 1
    assert (scrub(home).damaged, len(scrub(home).missing)) == ((), 1)


async def test_the_same_content_posted_again_mends_a_damaged_blob(world, home):
    victim = next(home / name for name in sorted(blobs(home)) if "/cloud/" in name)
    whole = victim.read_bytes()
    flip_a_bit(victim)
    scrub(home)
    world.context.blobs.put(TENANT, "cloud", whole)
    assert scrub(home).missing == () and victim.read_bytes() == whole


async def test_the_doctor_names_what_is_wrong(world, home):
    def findings(full=False):
        return {finding.check: finding for finding in examine(home, full=full)}

    assert all(finding.ok for finding in findings(full=True).values())
    assert "12 of 12 read" in findings(full=True)["blobs"].detail

    def become_newer(uow):
        uow.connection.exec_driver_sql("UPDATE alembic_version SET version_num = '9999'")

    world.context.transactions.write(become_newer).result()
    assert findings()["schema"].ok is False and "newer" in findings()["schema"].detail
    for name in blobs(home):
        (home / name).unlink()
    assert findings()["blobs"].ok is False and "12 missing or damaged" in findings()["blobs"].detail


async def test_the_commands_back_up_restore_and_scrub(world, home, tmp_path):
    run = CliRunner()
    made = run.invoke(app, ["backup", str(tmp_path / "b"), "--home", str(home), "--json"])
    assert made.exit_code == 0 and json.loads(made.stdout)["blobs"] == 12
    restored = run.invoke(
        app, ["restore", str(tmp_path / "b"), "--home", str(tmp_path / "r"), "--key", str(home / KEY_FILE)]
    )
    assert restored.exit_code == 0 and "12 blobs" in restored.stdout
    flip_a_bit(tmp_path / "r" / sorted(blobs(tmp_path / "r"))[0])
    scrubbed = run.invoke(app, ["scrub", "--home", str(tmp_path / "r")])
    assert scrubbed.exit_code == 1 and "damaged, moved aside" in scrubbed.output
    again = run.invoke(app, ["backup", str(tmp_path / "c"), "--home", str(tmp_path / "r")])
    assert again.exit_code == 1 and "lost before this backup" in again.output


async def test_of_two_backups_into_one_folder_at_once_one_is_refused(world, home, tmp_path, monkeypatch):
    copying, go_on, real = threading.Event(), threading.Event(), backup._copy_database

    def wait_in_between(*arguments):
        real(*arguments)
        copying.set()
        assert go_on.wait(PATIENCE_S)

    monkeypatch.setattr(backup, "_copy_database", wait_in_between)
    first = asyncio.create_task(asyncio.to_thread(make_backup, home, tmp_path / "backup", "1.0"))
    await asyncio.to_thread(copying.wait, 30)
    with pytest.raises(FileExistsError, match="another process"):
        make_backup(home, tmp_path / "backup", "1.0")
    go_on.set()
    assert (await first).blobs == 12
    restore_backup(tmp_path / "backup", tmp_path / "restored", own_key(home))
    assert healthy(tmp_path / "restored")


async def test_what_an_interrupted_backup_left_is_not_in_the_next(world, home, tmp_path):
    left = tmp_path / "backup.partial"
    (left / "blobs").mkdir(parents=True)
    (left / "blobs/stranger").touch()
    (left / "revisit.db").write_bytes(b"half a database")
    make_backup(home, tmp_path / "backup", "1.0")
    assert not left.exists()
    assert len(blobs(tmp_path / "backup")) == 12


@pytest.mark.parametrize("umask", [0o000, 0o022])
async def test_a_backup_and_what_is_restored_from_it_are_for_their_owner_only(world, home, tmp_path, umask):
    before = os.umask(umask)
    try:
        make_backup(home, tmp_path / "backup", "1.0")
        restore_backup(tmp_path / "backup", tmp_path / "restored", own_key(home))
    finally:
        os.umask(before)
    for folder in (tmp_path / "backup", tmp_path / "restored"):
        made = [folder, *folder.rglob("*")]
        assert {stat.S_IMODE(path.stat().st_mode) for path in made} == {0o600, 0o700}


def edited(archive: Path) -> None:
    """What somebody does who can write where backups lie: change a row, and the hash in the manifest with it."""
    with closing(sqlite3.connect(archive / "revisit.db")) as database:
        database.execute("UPDATE submaps SET submap_id = 'forged' WHERE submap_id = 's0'")
        database.commit()
    digest = hashlib.sha256((archive / "revisit.db").read_bytes()).hexdigest()
    rewrite(archive, database_sha256=digest)


async def test_an_edited_database_with_a_matching_manifest_is_refused(archive, home, tmp_path):
    key = own_key(home)
    edited(archive)
    for signature in ("", "0" * 64, json.loads((archive / "manifest.json").read_text())["signature"]):
        rewrite(archive, signature=signature)
        with pytest.raises(BackupRefused, match="not signed with this key"):
            restore_backup(archive, tmp_path / "restored", key)
    assert not (tmp_path / "restored").exists()
    with pytest.raises(BackupRefused, match="damaged: submaps"):
        restore_backup(archive, tmp_path / "anybody's", None)  # its row is not what the service wrote


async def test_the_key_is_in_no_backup_and_signs_those_of_the_restored_folder_too(archive, home, tmp_path):
    assert not list(archive.rglob(KEY_FILE)) and stat.S_IMODE((home / KEY_FILE).stat().st_mode) == 0o600
    restore_backup(archive, tmp_path / "restored", own_key(home))
    assert read_secret(tmp_path / "restored" / KEY_FILE) == own_key(home)
    make_backup(tmp_path / "restored", tmp_path / "second", "1.0")
    restore_backup(tmp_path / "second", tmp_path / "third", own_key(home))
    (tmp_path / "stranger").mkdir()
    with pytest.raises(BackupRefused, match="not signed"):
        restore_backup(tmp_path / "second", tmp_path / "fourth", own_key(tmp_path / "stranger"))


async def test_a_backup_of_before_there_were_signatures_is_restored_where_that_is_asked_for(archive, home, tmp_path):
    manifest = json.loads((archive / "manifest.json").read_text())
    old = {name: value for name, value in manifest.items() if name != "signature"}
    (archive / "manifest.json").write_text(json.dumps({**old, "format": 1}))
    with pytest.raises(BackupRefused, match="not signed"):
        restore_backup(archive, tmp_path / "restored", own_key(home))
    run = CliRunner()
    undecided = run.invoke(app, ["restore", str(archive), "--home", str(tmp_path / "restored")])
    assert undecided.exit_code != 0 and not (tmp_path / "restored").exists()
    taken = run.invoke(app, ["restore", str(archive), "--home", str(tmp_path / "restored"), "--unsigned"])
    assert taken.exit_code == 0 and names(tmp_path / "restored") == {"s0", "s1", "s2", "s3"}


def test_a_file_that_is_no_key_is_refused(tmp_path):
    for content in ("", "00", "zz" * 32):
        (tmp_path / KEY_FILE).write_text(content)
        with pytest.raises(ValueError, match="holds no secret"):
            own_key(tmp_path)
    keep_secret(tmp_path / KEY_FILE, b"k" * 32)
    assert own_key(tmp_path) == b"k" * 32

"""The service over SQLite and a bucket: its whole way once, a bucket that is out of reach, its start and its care."""

from __future__ import annotations

import asyncio
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import httpx
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.service.__main__ import main
from revisit.service.composition import require_bucket
from revisit.service.domain.errors import StorageUncertain
from revisit.service.engines.local.sqlite.backup import make_backup, restore_backup
from revisit.service.engines.local.sqlite.backup_key import own_key
from revisit.service.engines.local.sqlite.examination import examine, scrub
from revisit.service.engines.s3.blobs import S3BlobStore
from revisit.service.features.operations.claiming import JobClaims
from revisit.service.features.search.calls import LocalizeQuery
from revisit.service.features.upkeep.sweeping import collect, sweep
from revisit.service.ports.disk import UnlimitedDisk
from revisit.service.settings import Settings
from tests.support.live_service import connected, live_service, published_drives
from tests.support.patience import eventually
from tests.support.processes import ROOT
from tests.support.s3 import moto, nanio, variables
from tests.support.s3_link import SLOW_DOWN, WHOLE, Fault, at_first, s3_link
from tests.support.service_world import (
    SESSION,
    TENANT,
    answered,
    cloud,
    described,
    posted,
    sqlite_world,
    submap,
)

CONFIGURATION, TRY_AGAIN = 78, 75


def use(monkeypatch, address, **other) -> None:
    for name, value in variables(address, **other).items():
        monkeypatch.setenv(name, value)


@pytest.fixture
def bucket(monkeypatch) -> str:
    use(monkeypatch, nanio().address)
    return f"s3://{nanio().new_bucket()}/fleet"


@pytest.fixture
def link(bucket, monkeypatch):
    with s3_link(nanio().address) as link:
        use(monkeypatch, link.url)
        yield link


@pytest.fixture
def world(tmp_path, bucket):
    made = sqlite_world(tmp_path / "home", blobs=S3BlobStore(bucket, retries_s=0.2))
    yield made
    made.context.transactions.close()


def objects(bucket) -> dict[str, Path]:
    """The objects by the last part of their names."""
    folder = nanio().folder / bucket.removeprefix("s3://")
    return {path.name: path for path in folder.rglob("*") if path.is_file() and ".nanio-meta" not in path.parts}


async def swept(world) -> int:
    """Collect all blobs that no row names, however young; how many."""
    await sweep(world.context.storage, 0.0)
    return await collect(world.context.storage, 0.0)


@pytest.mark.parametrize("transport", ["rest", pytest.param("grpc", marks=pytest.mark.slow)])
def test_a_map_is_driven_downloaded_and_deleted_and_the_bucket_is_left_empty(world, bucket, tmp_path, transport):
    with live_service(world) as service, connected(service, transport) as client:
        published = published_drives(client)
        assert {loop.state for loop in client.loop_closures("maps/town", state="ALL")} >= {"ACCEPTED"}
        client.download_map_file(published, tmp_path / "town.rvmap")
        assert hashlib.sha256((tmp_path / "town.rvmap").read_bytes()).hexdigest() == published.map_hash
        of_file = f"{service.http}{published.map_download_link}"
        part = httpx.get(of_file, headers={"range": "bytes=100-199"})
        assert (part.status_code, part.content) == (206, (tmp_path / "town.rvmap").read_bytes()[100:200])
        mesh = client.download("maps/town/sessions/monday/submaps/s1", "mesh")
        assert mesh.startswith(b"ply")
        assert not (tmp_path / "home" / "blobs").exists() and len(objects(bucket)) > 6
        client.delete("maps/town")
    asyncio.run(swept(world))
    assert objects(bucket) == {}


async def test_while_the_bucket_is_out_of_reach_posts_are_open_and_no_job_is_begun(link, world):
    await posted(world, waits=1)
    link.fault = at_first(SLOW_DOWN, times=1_000)
    blobs = world.context.blobs
    claims = JobClaims(world.context.transactions, UnlimitedDisk(), blobs, "w1")
    with pytest.raises(StorageUncertain):
        await world.use_cases.posting.post(TENANT, submap("refused", 2))
    assert claims.next() is None
    link.fault = at_first(WHOLE)
    eventually(lambda: not blobs.unreachable(), "the bucket is not asked again")
    lease = claims.next()
    assert lease is not None and (lease.job.attempts, lease.job.forgiven) == (1, 0)


async def test_a_job_that_meets_a_bucket_out_of_reach_waits_and_is_not_blamed(link, world):
    await posted(world, s1=1)
    link.fault = at_first(SLOW_DOWN, times=1_000)
    world.worker().run(world.claim())
    (job,) = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT)).result()
    assert (job.state, job.counted_attempts) == ("QUEUED", 0)


async def test_an_answer_does_not_wait_for_the_cloud_of_its_query_to_be_deleted(link, world):
    await described(world, s1=1)
    forbidden = Fault(refused=(403, "AccessDenied"))
    link.fault = lambda request: forbidden if request.method == "POST" else WHOLE
    found = await answered(world, world.use_cases.searches.localize(TENANT, LocalizeQuery(SESSION.map_id, cloud(1))))
    assert found.best is not None


async def test_readiness_names_a_bucket_that_does_not_answer(link, world):
    link.fault = at_first(SLOW_DOWN, times=1_000)
    with pytest.raises(StorageUncertain):
        world.context.blobs.put(TENANT, "cloud", b"points")
    readiness = await world.use_cases.system.readiness()
    assert readiness.ready and any("the store of blobs does not answer" in one for one in readiness.degraded)


async def test_a_sweep_finds_the_blobs_of_a_bucket_that_no_row_names(world, bucket):
    await described(world, s1=1, s2=2)
    kept = objects(bucket)
    world.context.blobs.put(TENANT, "cloud", b"nobody names me")
    assert await swept(world) == 1
    assert objects(bucket) == kept


@pytest.mark.parametrize(
    ("url", "address", "status", "words"),
    [
        ("s3://nowhere/fleet", None, CONFIGURATION, "s3://nowhere/fleet cannot be used: there is no such bucket"),
        pytest.param(None, "127.0.0.1:9", TRY_AGAIN, "cannot be used: no answer", marks=pytest.mark.slow),
        ("http://nowhere", None, CONFIGURATION, "REVISIT_BLOB_URL"),
    ],
)
def test_a_start_without_a_usable_bucket_is_refused_in_one_line(
    bucket, tmp_path, monkeypatch, capsys, url, address, status, words
):
    if address:
        use(monkeypatch, address)
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path / "home"))
    monkeypatch.setenv("REVISIT_BLOB_URL", url or bucket)
    assert main(["serve"]) == status
    told = capsys.readouterr().err.splitlines()[-1]
    assert words in told


async def test_a_bucket_without_the_clouds_that_rows_name_is_refused(world, bucket, tmp_path):
    await posted(world, s1=1)
    settings = Settings(home=tmp_path / "home", blob_url=bucket)
    require_bucket(settings)
    other = Settings(home=tmp_path / "home", blob_url=f"{bucket}/elsewhere")
    with pytest.raises(Exception, match="holds none of the 1 newest clouds") as refused:
        require_bucket(other)
    assert refused.value.for_good


async def test_doctor_and_scrub_look_into_the_bucket(world, bucket, tmp_path):
    await described(world, s1=1, s2=2)
    home, store = tmp_path / "home", S3BlobStore(bucket)
    findings = {one.check: one for one in examine(home, full=True, bucket=store)}
    assert findings["bucket"].ok and findings["blobs"].detail.startswith("6 of 6 read, 0 missing")
    first, second, *_ = objects(bucket).values()
    first.write_bytes(bytes(first.stat().st_size))
    second.unlink()
    assert not next(one for one in examine(home, full=True, bucket=store) if one.check == "blobs").ok
    assert store.quarantined() == 0
    found = scrub(home, store)
    assert ([name[-64:] for name in found.damaged], [name[-64:] for name in found.missing]) == (
        [first.name],
        [second.name],
    )
    assert {one.check: one.ok for one in examine(home, full=False, bucket=store)}["quarantine"] is False


def test_doctor_says_what_is_wrong_with_a_bucket_and_that_one_keeps_versions(tmp_path, bucket, monkeypatch):
    (found,) = [one for one in examine(tmp_path, full=False, bucket=S3BlobStore("s3://nowhere")) if one.ok is False]
    assert (found.check, found.detail) == ("bucket", "s3://nowhere cannot be used: there is no such bucket")
    use(monkeypatch, moto().address)
    store = S3BlobStore(f"s3://{moto().new_bucket(versions=True)}")
    (told,) = [one for one in examine(tmp_path, full=False, bucket=store) if one.check == "versions of objects"]
    assert told.ok is None and "lifecycle rule" in told.detail


def test_doctor_looks_into_the_bucket_beside_a_database_server(bucket, monkeypatch):
    monkeypatch.setenv("REVISIT_DATABASE_URL", "postgresql://nobody@127.0.0.1:9/nothing")
    monkeypatch.setenv("REVISIT_BLOB_URL", bucket)
    ran = CliRunner().invoke(app, ["doctor", "--json", "--http", "http://127.0.0.1:9", "--grpc", "127.0.0.1:9"])
    found = {one["check"]: one["ok"] for one in json.loads(ran.stdout)}
    assert (found["database"], found["bucket"]) == (False, True)


async def test_a_backup_holds_the_blobs_of_the_bucket_and_is_restored_into_another(world, bucket, tmp_path):
    await described(world, s1=1)
    home, archive = tmp_path / "home", tmp_path / "backup"
    manifest = make_backup(home, archive, "1.0", S3BlobStore(bucket))
    assert (manifest.blobs, manifest.lost) == (3, ())
    other = S3BlobStore(f"s3://{nanio().new_bucket()}")
    restore_backup(archive, tmp_path / "restored", own_key(home), other)
    assert not (tmp_path / "restored" / "blobs").exists()
    assert {one.sha256 for one in other.stored(0.0)} == {one.sha256 for one in S3BlobStore(bucket).stored(0.0)}


def test_the_default_needs_nothing_of_the_extra_and_a_bucket_says_which_one_it_needs(tmp_path):
    script = (
        "import sys; sys.modules['obstore'] = None\n"
        "from pathlib import Path\n"
        "from revisit.service.composition import build_context\n"
        "from revisit.service.settings import Settings\n"
        "import revisit.service.gateway, revisit.cli.doctor, revisit.cli.backup\n"
        "context = build_context(Settings(home=Path(sys.argv[1])), gateway=False)\n"
        "print(type(context.blobs).__name__)\n"
        "try:\n"
        "    build_context(Settings(home=Path(sys.argv[1]), blob_url='s3://bucket'), gateway=False)\n"
        "except ImportError as error:\n"
        "    print(error)\n"
    )
    command = [sys.executable, "-c", script, str(tmp_path)]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.splitlines() == [
        "FileBlobStore",
        "REVISIT_BLOB_URL needs obstore: install revisit-loops[cluster]",
    ]

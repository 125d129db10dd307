"""Drives to be thinned by a policy of retention, and what is left of them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.retention import parsed
from revisit.service.failpoints import FailpointReached, arm
from revisit.service.features.retention.reports import RetentionReport
from revisit.service.features.retention.run import Retention
from revisit.service.features.upkeep.sweeping import collect, sweep
from tests.support.service_world import SESSION, TENANT, World, open_session, scan

HOUR_MS = 3_600_000
DAY_MS = 24 * HOUR_MS


async def streamed(
    world: World, scans: int, session: SessionKey = SESSION, *, tenant: TenantId = TENANT, first: int = 1
) -> None:
    """Scans a metre apart from `first` on, of which workers describe the submaps."""
    await open_session(world, session, tenant)
    for seq in range(first, first + scans):
        await world.use_cases.scans.append(tenant, scan(seq, float(seq), session))
    world.work_off()


async def driven(world: World, scans: int, session: SessionKey = SESSION, *, tenant: TenantId = TENANT) -> None:
    """As `streamed`; the drive has ended."""
    await streamed(world, scans, session, tenant=tenant)
    await world.use_cases.sessions.finish(tenant, session)
    world.work_off()


async def policy_set(world: World, text: str, map_id: str = SESSION.map_id, tenant: TenantId = TENANT) -> None:
    """Give a map a policy."""
    await world.use_cases.retention.set(tenant, map_id, parsed(text))


async def retained(world: World, text: str = "") -> RetentionReport | None:
    """Set the policy of the map, run the gateway's chore, and collect blobs without their hour: the map's last run."""
    if text:
        await policy_set(world, text)
    await world.context.retention.all()
    await collect(world.context.storage, 0.0)
    return await last_run(world)


async def last_run(world: World, map_id: str = SESSION.map_id, tenant: TenantId = TENANT) -> RetentionReport | None:
    """The report of the last run that removed anything."""
    return (await world.use_cases.retention.get(tenant, map_id)).last_run


def after_a_restart(world: World) -> Retention:
    """Retention as another process begins it."""
    context = world.context
    return Retention(context.storage, context.clock, context.policy)


async def cut_off_and_finished(world: World, failpoint: str) -> None:
    """A run that ends at a failpoint, and what the next process makes of it; blobs are collected without their hour."""
    arm(failpoint)
    with suppress(FailpointReached):
        await retained(world)
    arm("")
    await after_a_restart(world).all()
    await sweep(world.context.storage, 0.0)
    await collect(world.context.storage, 0.0)


def stored_seqs(world: World, session: SessionKey = SESSION, tenant: TenantId = TENANT) -> list[int]:
    """The numbers of the scans with a cloud that are stored of a session."""
    found = {"map_id": session.map_id, "session_id": session.session_id}
    rows = world.context.transactions.read(lambda uow: uow.scans.find(tenant, **found)).result()
    return [row.seq for row in rows if row.cloud_sha256]


def kept_scans(world: World, session: SessionKey = SESSION) -> list[str]:
    """What each submap of a session keeps of its scans."""
    read = world.context.transactions.read
    rows = read(lambda uow: uow.submaps.find(TENANT, map_id=session.map_id, session_id=session.session_id)).result()
    return [row.kept_scans for row in rows]


def blobs_of(world: World, kind: str) -> int:
    """How many blobs of a kind are stored."""
    return sum(one.kind == kind for one in world.context.blobs.stored(0.0))


def key_of(number: int, session: SessionKey = SESSION) -> SubmapKey:
    """The key of a window's submap by its first scan."""
    return SubmapKey(session.map_id, session.session_id, f"w{number}")


def disk_bytes(home: Path) -> int:
    """What a folder takes, as `du` counts it."""
    return sum(path.lstat().st_blocks * 512 for path in home.rglob("*") if path.is_file())

"""A short drive through every step of the service, in one process over SQLite and files: something to interrupt.

Four sessions are opened, one of which states its drift, submaps posted (two of one place, one that cannot be
described), scans appended, anchors posted, of which one is deleted, one submap and one session deleted, another session
finished, and the jobs run. The map is optimised twice, its rejected loops are tested again, tiles made of now and of a
moment, its drives compared, two plans put underneath, of which one is deleted, and its first version brought back; a
second map with anchors is merged into it, and taken out again. Doing it again after a crash must end where an
undisturbed run does: every step carries the client's own ids.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import sys
from collections.abc import Awaitable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from revisit.core.index import FaissIndex
from revisit.service.domain.errors import NotFound, SessionFinished
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.domain.states import AnchorFrame, AnchorKind, OperationKind
from revisit.service.engines.local.files.index_files import IndexFiles
from revisit.service.engines.local.sqlite.migration import migrate
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.anchors.rules import NewAnchor
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.graph.map_jobs import post_map_job
from revisit.service.features.index.keeping import IndexHealth
from revisit.service.features.merging.calls import MergeMap
from revisit.service.features.plans.calls import NewPlan
from revisit.service.features.plans.rules import PlanPin
from revisit.service.features.radio.calls import RadioReading
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect
from revisit.service.ports.map_tiles import Moment
from revisit.service.ports.transactions import UnitOfWork
from tests.faults.history import History, Kind, Outcome
from tests.support.fake_merger import EasyMerger
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED
from tests.support.made_pictures import a_png
from tests.support.service_world import TENANT, World, cloud_points, open_session, pose, scan, sqlite_world, submap
from tests.support.state import ON_POSTGRES
from tests.support.stepped_clock import PassingClock

POSTED = SessionKey("town", "posted")
STREAMED = SessionKey("town", "streamed")
STATED = SessionKey("town", "stated")
SCRAPPED = SessionKey("town", "scrapped")
PLACES = {"a": 1, "b": 2, "c": 1, "d": 3}
"""Posted submaps and the places they show: c closes a loop with a."""

SCRAPPED_PLACES = {"scrapped-described": 1, "scrapped-waiting": 5}
"""Submaps of the session that is deleted: one closes loops with a and c, one still waits for a worker."""

ANNEX = SessionKey("annex", "tuesday")
ANNEX_PLACES = {"annex-a": 1, "annex-d": 3}
"""Submaps of another map: they close loops with a, c and d."""

MISREAD, TAGGED = "misread", "tagged"
FIXES = {
    "told": (POSTED, 1_001),
    "between": (STREAMED, 250),
    MISREAD: (STREAMED, 350),
    TAGGED: (POSTED, 1_003),
    "copied": (ANNEX, 1_003),
}
"""Anchors with sessions and times; one is a tag. Of those of the scans the scans tell the pose; one is deleted."""

AS_OF_NS = 1_001
"""A moment at which some submaps were seen."""

WRONG_PLAN = "wrong"
"""The plan that is deleted."""

DEGENERATE = "degenerate"
DELETED = "b"
SCANS = 6
METRES_BETWEEN_SCANS = 4.0


def content(place: int, points: int = 300) -> str:
    """The hash by which a client knows the points of a place again."""
    return hashlib.sha256(cloud_points(place, points).tobytes()).hexdigest()


async def drive(world: World, history: History) -> None:
    """Do all of it, and note each step before and after."""
    world.merger = EasyMerger()
    # As a gateway does when it starts: what was being deleted goes.
    await world.context.erasure.all()
    await _collect(world)
    for session in (POSTED, STREAMED, SCRAPPED):
        await open_session(world, session)
    await world.use_cases.sessions.create(TENANT, CreateSession(STATED.map_id, STATED.session_id, drift="WHEEL"))
    await _hear(world, history)
    for submap_id, place in PLACES.items():
        await _post(world, history, submap_id, place, 300)
    await _post(world, history, DEGENERATE, 4, CANNOT_BE_DESCRIBED)
    with contextlib.suppress(SessionFinished):
        for seq in range(1, SCANS + 1):
            await _append(world, history, seq)
    for anchor_id in ("told", "between", MISREAD, TAGGED):
        await _anchor(world, history, anchor_id)
    described, waiting = SCRAPPED_PLACES
    await _post(world, history, described, SCRAPPED_PLACES[described], 300, SCRAPPED)
    world.work_off()
    await _post(world, history, waiting, SCRAPPED_PLACES[waiting], 300, SCRAPPED)
    removed = world.use_cases.submaps.delete(TENANT, SubmapKey(POSTED.map_id, POSTED.session_id, DELETED))
    await _delete(removed, history, DELETED)
    await _delete(world.use_cases.sessions.delete(TENANT, SCRAPPED), history, *SCRAPPED_PLACES)
    misread = world.use_cases.anchors.delete(TENANT, STREAMED.map_id, STREAMED.session_id, MISREAD)
    await _delete(misread, history, MISREAD, of="anchor")
    await _collect(world)
    await world.use_cases.sessions.finish(TENANT, STREAMED)
    world.work_off()
    for _ in range(2):
        await world.use_cases.map_versions.optimise(TENANT, POSTED.map_id)
        world.work_off()
    _test_rejected_loops_again(world)
    await _publish_and_look(world)
    await _put_plans_underneath(world, history)
    await _save_index(world)
    await world.use_cases.map_versions.revert(TENANT, POSTED.map_id, 1)
    await _merge_and_take_back(world, history)


async def _collect(world: World) -> None:
    """As a gateway does an hour later."""
    world.clock.ms += int(1000 * UNREFERENCED_S)
    await collect(world.context.storage)


def _test_rejected_loops_again(world: World) -> None:
    """As a service does that optimises maps by itself."""
    context = world.context

    def queue(uow: UnitOfWork) -> None:
        post_map_job(uow, TENANT, POSTED.map_id, OperationKind.RECALL_LOOPS, context.policy, context.clock.wall_ns())

    context.transactions.write(queue).result()
    world.work_off()


async def _publish_and_look(world: World) -> None:
    await world.use_cases.map_files.publish(TENANT, POSTED.map_id, 1)
    world.work_off()
    tiles = await world.use_cases.map_tiles.list(TENANT, POSTED.map_id, 1, PageRequest())
    for key in (tiles.items[0].key, replace(tiles.items[0].key, moment=Moment(AS_OF_NS))):
        await _worked_off(world, world.use_cases.map_tiles.download(TENANT, key, DownloadKind.MESH))
    await _worked_off(world, world.use_cases.map_changes.list(TENANT, POSTED.map_id, 1, PageRequest()))


async def _worked_off(world: World, question: Coroutine[Any, Any, object]) -> None:
    """Ask what waits for a worker."""
    asked = asyncio.create_task(question)
    while not asked.done():
        world.work_off()
        await asyncio.sleep(0.001)
    await asked


async def _save_index(world: World) -> None:
    """As a gateway does with large maps."""
    index = PlaceVectorIndex(FaissIndex, IndexFiles(world.home / "index"), saved_from=1)
    keeper = replace(world.context, index=index, index_health=IndexHealth()).index_keeper()
    await keeper.load()
    await keeper.tend_files()


async def _merge_and_take_back(world: World, history: History) -> None:
    await open_session(world, ANNEX)
    for submap_id, place in ANNEX_PLACES.items():
        await _post(world, history, submap_id, place, 300, ANNEX)
    await _anchor(world, history, "copied")
    world.work_off()
    jobs = world.context.transactions.read(lambda uow: uow.jobs.count(TENANT, kind="MERGE_MAP")).result()
    if not jobs:
        await world.use_cases.map_merges.merge(TENANT, MergeMap(POSTED.map_id, ANNEX.map_id))
    world.work_off()
    (merge,) = (await world.use_cases.map_merges.list(TENANT, POSTED.map_id, PageRequest())).items
    await world.use_cases.map_merges.revert(TENANT, POSTED.map_id, merge.merge_id)


def undisturbed(home: Path, log: Path, boot: str = "boot-1") -> None:
    """A drive from its beginning to its end over the store in `home`; what happened is appended to `log`."""
    if not ON_POSTGRES:
        migrate(home / "revisit.db")
    # The time of a server goes on, whatever is started again.
    world = sqlite_world(home, clock=PassingClock(boot_id=boot, ms=1_000_000 if boot == "boot-1" else 1_000_000_000))
    try:
        asyncio.run(drive(world, History(log)))
    finally:
        world.context.transactions.close()


async def _post(
    world: World, history: History, submap_id: str, place: int, points: int, session: SessionKey = POSTED
) -> None:
    operation = history.invoke("robot", Kind.PUT, f"submap/{submap_id}", content(place, points))
    await world.use_cases.posting.post(TENANT, submap(submap_id, place, session, points))
    history.settle(operation, Outcome.OK)


async def _anchor(world: World, history: History, anchor_id: str) -> None:
    """Post an anchor on earth, so that it is copied with its session, or the sighting of a tag."""
    session, stamp_ns = FIXES[anchor_id]
    T_odom_sensor = None if session == STREAMED else pose()
    kind, frame, position, tag = AnchorKind.GNSS, AnchorFrame.WGS84, (48.0, 11.0 + 1e-6 * stamp_ns, 500.0), None
    if anchor_id == TAGGED:
        kind, frame, position, tag = AnchorKind.FIDUCIAL, AnchorFrame.TAG, (0.0, 0.0, 0.0), "36h11:7"
    covariance = tuple(np.eye(3).ravel().tolist())
    anchor = NewAnchor(anchor_id, kind, frame, stamp_ns, position, covariance, T_odom_sensor=T_odom_sensor, tag=tag)
    operation = history.invoke("surveyor", Kind.PUT, f"anchor/{anchor_id}", str(position))
    await world.use_cases.anchors.post(TENANT, session, [anchor])
    history.settle(operation, Outcome.OK)


async def _hear(world: World, history: History) -> None:
    """Post what a robot hears while submaps are posted."""
    reading = RadioReading(1_001, tuple(f"{name:016x}" for name in range(5)), (-50, -51, -52, -53, -54))
    heard = reading.record(TENANT, POSTED).heard.hex()
    operation = history.invoke("robot", Kind.PUT, f"radio/{reading.stamp_ns}", heard)
    await world.use_cases.radio.post(TENANT, POSTED, [reading])
    history.settle(operation, Outcome.OK)


async def _put_plans_underneath(world: World, history: History) -> None:
    """Two pictures; the second is pinned anew and deleted."""
    plans, pins = world.use_cases.plans, [PlanPin(0.0, 0.0, 0.0, 0.0), PlanPin(9.0, 0.0, 9.0, 0.0)]
    for plan_id, red in (("ground", 10), (WRONG_PLAN, 20)):
        image = a_png(red=red)
        operation = history.invoke("person", Kind.PUT, f"plan/{plan_id}", hashlib.sha256(image).hexdigest())
        await plans.create(TENANT, NewPlan(POSTED.map_id, plan_id, image, pins))
        history.settle(operation, Outcome.OK)
    await plans.pin(TENANT, POSTED.map_id, WRONG_PLAN, pins[::-1])
    await _delete(plans.delete(TENANT, POSTED.map_id, WRONG_PLAN), history, WRONG_PLAN, of="plan")


async def _append(world: World, history: History, seq: int) -> None:
    opened = await world.use_cases.scans.open(TENANT, STREAMED)
    resumed = history.invoke("scanner", Kind.RESUME, "stream")
    history.settle(resumed, Outcome.OK, opened.committed_seq)
    operation = history.invoke("scanner", Kind.PUT, f"scan/{seq}", content(seq))
    await world.use_cases.scans.append(TENANT, scan(seq, METRES_BETWEEN_SCANS * seq, STREAMED))
    history.settle(operation, Outcome.OK)


async def _delete(removal: Awaitable[None], history: History, *ids: str, of: str = "submap") -> None:
    """Do `removal`, which takes these submaps, or what else they are, with it."""
    operations = [history.invoke("operator", Kind.DELETE, f"{of}/{one}") for one in ids]
    outcome = Outcome.OK
    try:
        await removal
    except NotFound:
        outcome = Outcome.FAIL
    for operation in operations:
        history.settle(operation, outcome)


if __name__ == "__main__":
    undisturbed(Path(sys.argv[1]), Path(sys.argv[2]))

"""Drives around one road, made up: each submap looks like where it was taken, and is compared by its true pose."""

from __future__ import annotations

import asyncio
import threading
import time
from dataclasses import replace

import numpy as np

from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.domain.records import LoopRecord, SubmapRecord
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.posting import PostSubmap
from tests.support.fake_recogniser import FakeRecogniser, placed
from tests.support.made_up_fleet import road
from tests.support.service_world import TENANT, World, cloud, open_session

FEATURES = np.random.default_rng(11).normal(size=(64, 2)) / 20.0


class RoadRecogniser(FakeRecogniser):
    """Descriptors that are alike where submaps are near each other; counts what it describes."""

    def __init__(self) -> None:
        self.described = 0

    def describe(self, submap, config):
        """From the pose alone, which is the true one."""
        self.described += 1
        waves = np.cos(FEATURES @ submap.T_odom_submap[:2, 3] + np.arange(64.0))
        vector = (waves / np.linalg.norm(waves)).astype(np.float32)
        return replace(super().describe(submap, config), descriptor=vector, place=placed(submap.T_odom_submap))


def drives(count: int, submaps: int) -> dict[SessionKey, np.ndarray]:
    """Poses (submaps, 4, 4) of each drive; the drives begin at other places of the road, every second one reversed."""
    starts = np.linspace(0.0, 6.0, count)
    return {
        SessionKey("town", f"drive-{number}"): road(submaps, start, -1 if number % 2 else 1)
        for number, start in enumerate(starts)
    }


async def post_drives(world: World, poses: dict[SessionKey, np.ndarray], every_s: float = 0.0) -> None:
    """Create the map and the sessions, and post the submaps: of each drive one after the other, of all in turn.

    One comes `every_s` seconds, if the store is as fast.
    """
    first, *others = poses
    await open_session(world, first)
    for session in others:
        await world.use_cases.sessions.create(TENANT, CreateSession(session.map_id, session.session_id))
    due_s = time.monotonic()
    for number in range(len(poses[first])):
        for session, of_drive in poses.items():
            key = SubmapKey(session.map_id, session.session_id, f"s{number:04d}")
            due_s += every_s
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            await world.use_cases.posting.post(TENANT, PostSubmap(key, of_drive[number], 1 + number, cloud(1, 100)))


def work_off_together(world: World, workers: int, recogniser: RoadRecogniser) -> None:
    """Run all jobs by so many workers at once, each with an index of its own. Raises the first error of one of them."""
    errors: list[BaseException] = []

    def work(number: int) -> None:
        runner = world.worker(recogniser)
        try:
            while (lease := world.claim(f"w{number}")) is not None:
                runner.run(lease)
        except BaseException as error:  # noqa: BLE001  # told by the caller
            errors.append(error)

    crew = [threading.Thread(target=work, args=(number,)) for number in range(workers)]
    for one in crew:
        one.start()
    for one in crew:
        one.join()
    if errors:
        raise errors[0]


def submaps_of(world: World) -> list[SubmapRecord]:
    """In the order in which they entered the map."""
    found = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    return sorted(found, key=lambda one: one.entered)


def loops_of(world: World) -> dict[tuple[tuple[str, str], tuple[str, str]], tuple[object, ...]]:
    """Verdict of each loop by the names of its query and its match."""
    found = world.context.transactions.read(lambda uow: uow.loops.find(TENANT)).result()
    return {_ends(loop): _verdict(loop) for loop in found}


def _ends(loop: LoopRecord) -> tuple[tuple[str, str], tuple[str, str]]:
    return (loop.query_session_id, loop.query_submap_id), (loop.match_session_id, loop.match_submap_id)


def _verdict(loop: LoopRecord) -> tuple[object, ...]:
    set_aside = loop.graph_state == GraphState.SET_ASIDE
    evidence = {name: loop.evidence.get(name) for name in ("doubts", "support", "distinctiveness")}
    return loop.state, loop.reason, loop.similarity, loop.score, loop.T_match_query, evidence, set_aside

"""How many searches a submap takes in one map that many robots drive in at once, made up: as many as there are submaps.

The real stores and jobs, with descriptions that cost nothing and comparisons that wait. All times are twenty times as
long as they are said, so that the machine is not what is measured: 50, 100 and 200 submaps a second come from 40
drives, and a comparison takes 0.25 s from search to commit.
"""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from dataclasses import replace

import pytest

from revisit.core.config import PipelineConfig
from revisit.service.domain.states import SubmapState
from tests.support.drives_on_a_road import RoadRecogniser, drives, loops_of, post_drives, submaps_of
from tests.support.figures import publish
from tests.support.memory.vector_index import MemoryVectorIndex
from tests.support.service_world import sqlite_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

SLOWER = 20.0
COMPARED_S = 0.25
CANDIDATES = 4
DRIVES = 40
ARRIVE_S = 6.0
SETTLED_S = 5.0


class WaitingRecogniser(RoadRecogniser):
    """The comparisons of a submap together take a while, in which the core is free."""

    def __init__(self) -> None:
        super().__init__()
        self._asked = threading.local()

    def verify(self, query, match, similarity, config, initial=None):
        if getattr(self._asked, "query", None) != query:
            self._asked.query = query
            time.sleep(SLOWER * COMPARED_S)
        return super().verify(query, match, similarity, config, initial)


class Crew:
    """Workers that run whatever is due, until they are told to go home. One asks the store for all of them."""

    def __init__(self, world, workers: int) -> None:
        self.recogniser, self._ended = WaitingRecogniser(), threading.Event()
        self._world, self._leases = world, queue.SimpleQueue()
        self._at_rest = threading.Semaphore(workers)
        self._threads = [threading.Thread(target=self._work) for _ in range(workers)]
        self._threads.append(threading.Thread(target=self._hand_out))
        for one in self._threads:
            one.start()

    def go_home(self) -> None:
        self._ended.set()
        for _ in self._threads:
            self._leases.put(None)
        for one in self._threads:
            one.join()

    def _hand_out(self) -> None:
        while not self._ended.is_set():
            if not self._at_rest.acquire(timeout=0.1):
                continue
            lease = self._world.claim("crew")
            if lease is None:
                self._at_rest.release()
                self._ended.wait(0.02)
            else:
                self._leases.put(lease)

    def _work(self) -> None:
        runner = self._world.worker(self.recogniser)
        while (lease := self._leases.get()) is not None:
            runner.run(lease)
            self._at_rest.release()


@pytest.mark.parametrize("rate", [50, 100, 200])
def test_a_busy_map_takes_one_search_a_submap(tmp_path, monkeypatch, rate):
    searched, search = [], MemoryVectorIndex.search

    def noted(index, map_number, vector, k, where):
        searched.append(time.monotonic())
        return search(index, map_number, vector, k, where)

    monkeypatch.setattr(MemoryVectorIndex, "search", noted)
    loop = replace(PipelineConfig().loop, candidates=CANDIDATES)
    world = sqlite_world(tmp_path, lease_ms=600_000, pipeline=replace(PipelineConfig(), loop=loop))
    submaps = int(rate * ARRIVE_S) // DRIVES * DRIVES
    crew = Crew(world, workers=int(rate * COMPARED_S * 1.5) + 8)
    began_s = time.monotonic()
    asyncio.run(post_drives(world, drives(DRIVES, submaps // DRIVES), every_s=SLOWER / rate))
    arrived_s = time.monotonic() - began_s
    while not all(one.searched and one.state == SubmapState.DESCRIBED for one in submaps_of(world)):
        assert time.monotonic() - began_s - arrived_s < SLOWER * SETTLED_S, "the map does not settle"
        time.sleep(0.2)
    settled_s = time.monotonic() - began_s - arrived_s
    crew.go_home()
    searches = len(searched) / submaps
    figures = {"came": submaps / arrived_s * SLOWER, "searches": searches, "settled_s": settled_s / SLOWER}
    rounded = {name: round(figure, 3) for name, figure in figures.items()}
    publish("a busy map", rate=rate, submaps=submaps, loops=len(loops_of(world)), **rounded)
    world.context.transactions.close()
    assert crew.recogniser.described == submaps and searches <= 1.1

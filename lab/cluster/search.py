"""Searches that go to a search process: time and CPU end to end, and recall, beside the exact answer.

`python -m lab.cluster.search COUNT`: a process holds COUNT made-up descriptors, another asks. Descriptors vary in 60
directions, as those of real drives do in few, and each place is seen five times; nothing is read from a database.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from types import SimpleNamespace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from revisit.core.index import ExactIndex, FaissIndex, IndexEntry, SearchFilter
from revisit.service.domain.errors import Unavailable
from revisit.service.domain.identity import TenantId
from revisit.service.domain.processes import LivingProcess, ProcessRole
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.ports.index import IndexChange, VectorFilter
from revisit.service.ports.place_search import PlaceQuestion, PlaceSearch
from revisit.service.ports.transactions import Transactions
from revisit.service.search.client import RemotePlaceSearch
from revisit.service.search.load import MapLoad
from revisit.service.search.server import PlaceSearchServer

Vectors = NDArray[np.float32]
T = TypeVar("T")

DIMENSION, DIRECTIONS, SEEN, K = 1024, 60, 5, 20
SECRET, TENANT, MAP = b"s" * 32, TenantId("lab"), 1
PORTION = 4096
MOST_EXACT, COMPARED = 100_000, 50
"""Up to so many places, so many answers are compared with the exact ones."""


class NoRows:
    """A store in which nothing changes; `processes` live."""

    def __init__(self, processes: list[LivingProcess]) -> None:
        self._processes = processes

    def read_here(self, work: Callable[[Any], T]) -> T:
        """See `Transactions`."""
        changes = SimpleNamespace(since=lambda *_: [])
        return work(SimpleNamespace(changes=changes, processes=SimpleNamespace(alive=lambda *_: self._processes)))


def places(count: int) -> Iterator[Vectors]:
    """Portions of descriptors: every place five times, each time a little different."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(DIRECTIONS, DIMENSION)).astype(np.float32)
    for start in range(0, count, PORTION):
        many = min(PORTION, count - start)
        of_place = np.random.default_rng([1, start % max(1, count // SEEN // PORTION * PORTION)])
        base = of_place.normal(size=(many, DIRECTIONS)).astype(np.float32)
        seen = base + 0.3 * rng.normal(size=base.shape).astype(np.float32)
        yield seen @ directions + rng.normal(size=(many, DIMENSION)).astype(np.float32)


def serve(count: int, channel: Connection) -> None:
    """The search process: tells its port and the CPU seconds of loading, then those of its answers."""
    index, number, loaded_s = PlaceVectorIndex(FaissIndex), 0, 0.0
    for vectors in places(count):
        changes = []
        for vector in vectors:
            number += 1
            where = (float(number), 0.0, 0.0)
            changes.append(IndexChange(number, number, number // 500, number % 500, where, vector.tobytes()))
        began_s = time.process_time()
        index.apply(MAP, changes, changes[0].seq - 1, more=number < count)
        loaded_s += time.process_time() - began_s
    search = CaughtUpIndex(cast(Transactions, NoRows([])), index)
    server = PlaceSearchServer(search, SECRET, MapLoad())
    channel.send((server.start("127.0.0.1:0"), loaded_s))
    while channel.recv():
        channel.send(time.process_time())
    server.stop(1.0)


def exact(count: int, queries: Vectors, where: VectorFilter) -> list[set[int]]:
    """The numbers of the K nearest of each query, by comparison with every descriptor."""
    index, number = ExactIndex(DIMENSION), 0
    for vectors in places(count):
        rows = range(number + 1, number + len(vectors) + 1)
        index.add([IndexEntry(row, row // 500, row % 500, np.array([float(row), 0.0, 0.0])) for row in rows], vectors)
        number = rows[-1]
    only = SearchFilter(of_session=where.of_session, only_sessions=where.only_sessions, without=where.without)
    return [{match.id for match in index.search(query, K, only)} for query in queries]


def main() -> None:
    """Measure, and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--searches", type=int, default=200)
    options = parser.parse_args()
    here, there = get_context("spawn").Pipe()
    process = get_context("spawn").Process(target=serve, args=(options.count, there))
    process.start()
    port, loaded_s = here.recv()
    figures = measured(options.count, options.searches, port, here)
    head = {"places": options.count, "load": os.getloadavg()[0], "loaded, CPU s": round(loaded_s, 1)}
    print(json.dumps({**head, **figures}, indent=2))
    here.send(None)
    process.join()


def measured(count: int, searches: int, port: int, channel: Connection) -> dict[str, dict[str, float]]:
    """Milliseconds of a search as who asks sees them, and of CPU in the process that answers."""
    alive = [LivingProcess("lab", ProcessRole.SEARCH, f"127.0.0.1:{port}", ready=True)]
    remote = RemotePlaceSearch(cast(Transactions, NoRows(alive)), SECRET, cast(PlaceSearch, None))
    noise = 0.1 * np.random.default_rng(2).normal(size=(searches, DIMENSION))
    queries = (next(places(count))[:searches] + noise).astype(np.float32)
    figures: dict[str, dict[str, float]] = {}
    for name, where in filters(count).items():
        questions = [PlaceQuestion(TENANT, MAP, query, K, where) for query in queries]
        answered(remote, questions[0])
        took_ms, spent_ms, found = [], [], []
        for question in questions:
            before_s, began_s = cpu_s(channel), time.perf_counter()
            answer = remote.nearest(question)
            took_ms.append(1e3 * (time.perf_counter() - began_s))
            spent_ms.append(1e3 * (cpu_s(channel) - before_s))
            found.append({match.submap_number for match in answer.matches})
        figures[name] = {**spread("ms", took_ms), **spread("CPU ms", spent_ms)}
        if count <= MOST_EXACT:
            true = exact(count, queries[:COMPARED], where)
            shares = [len(one & other) / K for one, other in zip(found, true, strict=False)]
            figures[name] |= {"recall": round(float(np.mean(shares)), 4)}
    return figures


def answered(remote: RemotePlaceSearch, question: PlaceQuestion) -> None:
    """Ask until there is an answer: the first one loads what later ones need, on a busy machine for a while."""
    while True:
        try:
            remote.nearest(question)
            return
        except Unavailable:
            continue


def spread(unit: str, values: list[float]) -> dict[str, float]:
    """Median and 99th percentile."""
    p50, p99 = np.percentile(values, [50, 99])
    return {f"p50 {unit}": round(float(p50), 2), f"p99 {unit}": round(float(p99), 2)}


def cpu_s(channel: Connection) -> float:
    """CPU seconds of the process that answers."""
    channel.send("cpu")
    return float(channel.recv())


def filters(count: int) -> dict[str, VectorFilter]:
    """All but the own surroundings, and only 10 and 1 % of the sessions."""
    sessions = range(count // 500 + 1)
    own = frozenset(range(201, 300))
    return {
        "all": VectorFilter(of_session=0, without=own),
        "10 %": VectorFilter(only_sessions=frozenset(sessions[::10]), without=own),
        "1 %": VectorFilter(only_sessions=frozenset(sessions[::100]), without=own),
    }


if __name__ == "__main__":
    main()

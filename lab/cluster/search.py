"""Searches that go to a search process: time and CPU end to end, and recall, beside the exact answer.

`python -m lab.cluster.search COUNT`: a process holds COUNT made-up descriptors, another asks. Descriptors vary in 60
directions, as those of real drives do in few, and each place is seen five times; nothing is read from a database.
`--retired 0.3`: of the places so many have left again when the questions come, half of them with whole sessions.
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
"""Up to so many places, so many answers are compared with the exact ones, if nothing else is asked for."""

SESSION = 500
"""Places of a session."""


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


def retired(count: int, share: float) -> NDArray[np.int64]:
    """The numbers of the places that leave: whole sessions but the first, and as many of the others, here and there."""
    numbers = np.arange(1, count + 1)
    rng = np.random.default_rng(3)
    whole = rng.random(count // SESSION + 1)[numbers // SESSION] < share / 2
    whole[: SESSION - 1] = False
    alone = rng.random(count) < (share / 2) / (1 - share / 2)
    return numbers[whole | alone]


def serve(count: int, share: float, channel: Connection) -> None:
    """The search process: tells its port and the CPU seconds of loading, then those of its answers."""
    index, number, loaded_s = PlaceVectorIndex(FaissIndex), 0, 0.0
    for vectors in places(count):
        changes = []
        for vector in vectors:
            number += 1
            where = (float(number), 0.0, 0.0)
            changes.append(IndexChange(number, number, number // SESSION, number % SESSION, where, vector.tobytes()))
        began_s = time.process_time()
        index.apply(MAP, changes, changes[0].seq - 1, more=number < count)
        loaded_s += time.process_time() - began_s
    for gone in np.array_split(retired(count, share), max(1, round(share * count / PORTION))):
        changes = [IndexChange(at, int(one), 0, 0, (0.0, 0.0, 0.0), None) for at, one in enumerate(gone, number + 1)]
        began_s = time.process_time()
        index.apply(MAP, changes, number)
        loaded_s += time.process_time() - began_s
        number += len(changes)
    search = CaughtUpIndex(cast(Transactions, NoRows([])), index)
    server = PlaceSearchServer(search, SECRET, MapLoad())
    channel.send((server.start("127.0.0.1:0"), loaded_s))
    while channel.recv():
        channel.send(time.process_time())
    server.stop(1.0)


def exact(count: int, share: float) -> ExactIndex:
    """The places that are left, to be compared one by one."""
    index, number, gone = ExactIndex(DIMENSION), 0, set(retired(count, share).tolist())
    for vectors in places(count):
        kept = [(row, at) for at, row in enumerate(range(number + 1, number + len(vectors) + 1)) if row not in gone]
        entries = [IndexEntry(row, row // SESSION, row % SESSION, np.array([float(row), 0.0, 0.0])) for row, _ in kept]
        index.add(entries, vectors[[at for _, at in kept]])
        number += len(vectors)
    return index


def recall(found: list[set[int]], queries: Vectors, index: ExactIndex, where: VectorFilter) -> float:
    """The share of the K nearest of all queries that was found."""
    only = SearchFilter(of_session=where.of_session, only_sessions=where.only_sessions, without=where.without)
    true = [{match.id for match in index.search(query, K, only)} for query in queries]
    right = sum(len(one & other) for one, other in zip(found, true, strict=False))
    return right / sum(map(len, true))


def main() -> None:
    """Measure, and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--searches", type=int, default=200)
    parser.add_argument("--retired", type=float, default=0.0, help="the share of the places that leave again")
    parser.add_argument("--compared", type=int, help="how many answers are compared with the exact ones")
    options = parser.parse_args()
    here, there = get_context("spawn").Pipe()
    process = get_context("spawn").Process(target=serve, args=(options.count, options.retired, there))
    process.start()
    port, loaded_s = here.recv()
    compared = COMPARED if options.count <= MOST_EXACT else 0
    compared = compared if options.compared is None else options.compared
    true = exact(options.count, options.retired) if compared else None
    figures = measured(options.count, options.searches, port, here, true, compared)
    places = {"places": options.count, "of these retired": options.retired}
    head = {**places, "load": os.getloadavg()[0], "loaded, CPU s": round(loaded_s, 1)}
    print(json.dumps({**head, **figures}, indent=2))
    here.send(None)
    process.join()


def measured(
    count: int, searches: int, port: int, channel: Connection, true: ExactIndex | None, compared: int
) -> dict[str, dict[str, float]]:
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
        if true is not None:
            figures[name]["recall"] = round(recall(found, queries[:compared], true, where), 4)
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
    sessions = range(count // SESSION + 1)
    own = frozenset(range(201, 300))
    return {
        "all": VectorFilter(of_session=0, without=own),
        "10 %": VectorFilter(only_sessions=frozenset(sessions[::10]), without=own),
        "1 %": VectorFilter(only_sessions=frozenset(sessions[::100]), without=own),
    }


if __name__ == "__main__":
    main()

"""How a service becomes slower, and its files larger, as one map grows: posts, answers, starts, deletion, database.

REVISIT_GROWTH_SUBMAPS (1000,10000,100000): submaps of the map, in sessions of a thousand. REVISIT_GROWTH_PICTURE names
the PNG that the curves are drawn into. REVISIT_GROWTH_POOL names .npz files (with colons between) whose "vectors" are
descriptors of places, as `python -m lab.domains` keeps them: the map's are then made up from these, alike to real ones,
and the answers are compared with those of a search that looks at all of them. No time is asserted, for a curve has no
bound: every size must answer.
"""

from __future__ import annotations

import os
import time
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from revisit import Client
from revisit.core.index.learning import site_of_arrays
from revisit.service.engines.local.files.index_files import IndexFiles
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.local.vector_index import SAVED_FROM
from tests.support.figures import publish
from tests.support.filled_store import fill_sessions
from tests.support.load import own_mib, quantile, rss_mib
from tests.support.patience import PATIENCE_S
from tests.support.processes import ServiceProcess, WorkerProcess
from tests.support.service_world import cloud_points, pose

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

SIZES = [int(size) for size in os.environ.get("REVISIT_GROWTH_SUBMAPS", "1000,10000,100000").split(",")]
SESSION = 1000
DIMENSION = 1024
COMPARED = 40
"""Searches of which the answers are compared with the exact ones."""
CALLS = 100
SEARCHES = 1000
"""Of a hundred the 99th percentile is the second worst: chance."""
OWN_RECOGNISER = "revisit.service.adapters.core_recogniser:load_recogniser"
TIMES = {
    "search_ms": "search by a submap, median",
    "search_p99_ms": "search by a submap, p99",
    "post_ms": "post of a submap, median",
    "list_ms": "list of a session, median",
    "delete_ms": "deletion of a session of 1,000",
    "ready_ms": "from start to ready",
}
MEMORY = {
    "database_mib": "database",
    "gateway_own_mib": "own memory of the gateway",
    "worker_own_mib": "own memory of a worker",
}


def timed_ms(call, arguments) -> list[float]:
    """How long each call took, milliseconds."""
    took = []
    for argument in arguments:
        began = time.perf_counter()
        call(argument)
        took.append(1000 * (time.perf_counter() - began))
    return took


def a_yard() -> np.ndarray:
    """A cloud (n, 3) that the method can describe: ground and four walls of different lengths."""
    rng = np.random.default_rng(1)
    ground = rng.uniform((-25, -25, -1.7), (25, 25, -1.7), (30000, 3))
    walls = [((-12, 14), (6, 14.2)), ((10, -10), (19, -9.8)), ((17, 2), (17.2, 13)), ((-15, -9), (-14.8, -2))]
    return np.vstack([ground, *(rng.uniform((*low, -1.7), (*high, 4.0), (6000, 3)) for low, high in walls)])


def pool() -> np.ndarray | None:
    """The descriptors (n, d) that those of the map are made from."""
    files = [Path(name) for name in os.environ.get("REVISIT_GROWTH_POOL", "").split(":") if name]
    return np.concatenate([np.load(file)["vectors"] for file in files]) if files else None


def exact_answers(home: Path, numbers: list[int]) -> list[set[str]]:
    """The ids of the 20 submaps that are most similar to each of those, of all in the file of the index."""
    store = SqliteTransactions(home / "revisit.db", checkpoints=False)
    name = store.read(lambda uow: uow.maps.of_all_tenants()[0].index_file).result()
    store.close()
    opened = IndexFiles(home / "index").open(name)
    ids, sessions, site = opened.arrays["ids"], opened.arrays["sessions"], site_of_arrays(opened.arrays, "site_")
    rows = np.searchsorted(ids, numbers)
    queries = site.adapted(opened.vectors[rows], sessions[rows])
    alike = np.empty((len(ids), len(rows)), np.float32)
    for start in range(0, len(ids), 10_000):
        part = slice(start, start + 10_000)
        alike[part] = site.adapted(opened.vectors[part], sessions[part]) @ queries.T
    alike[rows, np.arange(len(rows))] = -np.inf
    return [{f"s{number}" for number in ids[np.argpartition(-column, 20)[:20]]} for column in alike.T]


def recall_at_20(home: Path, service: ServiceProcess, submaps: int) -> float:
    """The share of the 20 most similar submaps that a search finds."""
    numbers = np.random.default_rng(3).integers(1, submaps + 1, COMPARED).tolist()
    found = []
    with Client(service.url) as client:
        for number, exact in zip(numbers, exact_answers(home, numbers), strict=True):
            hits = client.search("maps/town", submap=name_of(number), k=20)
            found.append(len(exact & {hit.submap.rpartition("/")[2] for hit in hits}) / 20)
    return float(np.mean(found))


def name_of(number: int) -> str:
    """The resource name of submap `number`."""
    return f"maps/town/sessions/d{(number - 1) // SESSION}/submaps/s{number}"


def of_the_service(service: ServiceProcess, submaps: int) -> dict[str, float]:
    """What clients see of a map of this size, without workers."""
    rng = np.random.default_rng(2)
    names = [name_of(number) for number in rng.integers(1, submaps + 1, SEARCHES)]
    with Client(service.url) as client:
        client.search("maps/town", submap=names[0])  # learns the statistics of the map
        searches = timed_ms(lambda name: client.search("maps/town", submap=name), names)
        lists = timed_ms(client.list_submaps, [name.rpartition("/submaps/")[0] for name in names[:10]])
        session, ids = client.create_session("maps/town", "new"), count()
        cloud, T_odom_submap = cloud_points(1, 2000), pose()
        posts = timed_ms(
            lambda name: client.post_submap(session, name, cloud, T_odom_submap, 1 + next(ids)),
            [f"n{n}" for n in range(CALLS)],
        )
        client.delete(session)  # and the jobs of its submaps
        deleted = timed_ms(client.delete, ["maps/town/sessions/d0"])
    return {
        "search_ms": quantile(0.5, searches),
        "search_p99_ms": quantile(0.99, searches),
        "list_ms": quantile(0.5, lists),
        "post_ms": quantile(0.5, posts),
        "delete_ms": deleted[0],
    }


def of_a_worker(home: Path, service: ServiceProcess) -> dict[str, float]:
    """From the start of a worker until its first submap is described and compared with the map, and its memory."""
    with Client(service.url) as client:
        session = client.create_session("maps/town", "yard")
        began = time.perf_counter()
        worker = WorkerProcess(home, recogniser=OWN_RECOGNISER)
        try:
            ready_s = time.perf_counter() - began
            client.wait(client.post_submap(session, "yard", a_yard(), pose(), 1), timeout_s=PATIENCE_S)
            return {
                "worker_ready_ms": 1000 * ready_s,
                "worker_first_ms": 1000 * (time.perf_counter() - began),
                "worker_mib": rss_mib(worker.pid),
                "worker_own_mib": own_mib(worker.pid),
            }
        finally:
            worker.close()


def measured(home: Path, submaps: int) -> dict[str, float]:
    """The figures of a map of this size."""
    sizes = {f"d{n}": min(SESSION, submaps - n * SESSION) for n in range(-(-submaps // SESSION))}
    known = pool()
    fill_sessions(home, sizes, DIMENSION, loops=True, pool=known)
    database = (home / "revisit.db").stat().st_size
    service = ServiceProcess(home, workers=0)
    try:
        service.wait_for("index_loaded", timeout_s=1800)
        if submaps >= SAVED_FROM:
            service.wait_for("index_file_written", timeout_s=1800)
        service.kill()
        began, seen = time.perf_counter(), len(service.events)
        service.start()
        service.wait_for("index_loaded", after=seen)
        ready_s = time.perf_counter() - began
        recall = {} if known is None or submaps < SAVED_FROM else {"recall_at_20": recall_at_20(home, service, submaps)}
        figures = recall | of_the_service(service, submaps) | {"ready_ms": 1000 * ready_s}
        return (
            figures
            | of_a_worker(home, service)
            | {"gateway_mib": rss_mib(service.pid), "gateway_own_mib": own_mib(service.pid)}
            | {"database_mib": database / 2**20}
        )
    finally:
        service.close()


def draw(rows: dict[int, dict[str, float]], picture: Path) -> None:
    """Times on the left, sizes on the right, over the submaps of the map."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout="constrained")
    times, sizes = figure.subplots(1, 2)
    for axes, unit, shown in ((times, "milliseconds", TIMES), (sizes, "MiB", MEMORY)):
        for key, name in shown.items():
            axes.loglog(list(rows), [row[key] for row in rows.values()], "o-", label=name)
        axes.set(xlabel="submaps of the map", ylabel=unit)
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    figure.savefig(picture, dpi=110)


def test_a_map_grows(tmp_path):
    rows = {}
    for submaps in SIZES:
        rows[submaps] = measured(tmp_path / str(submaps), submaps)
        publish("growth", submaps=submaps, **{key: round(value, 3) for key, value in rows[submaps].items()})
    if picture := os.environ.get("REVISIT_GROWTH_PICTURE"):
        draw(rows, Path(picture))
    assert all(min(row.values()) > 0 for row in rows.values())

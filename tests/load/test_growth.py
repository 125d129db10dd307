"""How a service becomes slower, and its files larger, as one map grows: posts, answers, starts, deletion, database.

REVISIT_GROWTH_SUBMAPS (1000,10000,100000): submaps of the map, in sessions of a thousand. REVISIT_GROWTH_PICTURE names
the PNG that the curves are drawn into. No time is asserted, for a curve has no bound: every size must answer.
"""

from __future__ import annotations

import os
import time
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from revisit import Client
from revisit.service.adapters.vector_index import SAVED_FROM
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
CALLS = 100
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


def of_the_service(service: ServiceProcess, submaps: int) -> dict[str, float]:
    """What clients see of a map of this size, without workers."""
    rng = np.random.default_rng(2)
    names = [f"maps/town/sessions/d{(n - 1) // SESSION}/submaps/s{n}" for n in rng.integers(1, submaps + 1, CALLS)]
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
    fill_sessions(home, sizes, DIMENSION, loops=True)
    database = (home / "revisit.db").stat().st_size
    service = ServiceProcess(home, workers=0)
    try:
        service.wait_for("index_loaded")
        if submaps >= SAVED_FROM:
            service.wait_for("index_file_written")
        service.kill()
        began, seen = time.perf_counter(), len(service.events)
        service.start()
        service.wait_for("index_loaded", after=seen)
        ready_s = time.perf_counter() - began
        figures = of_the_service(service, submaps) | {"ready_ms": 1000 * ready_s}
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
        publish("growth", submaps=submaps, **{key: round(value, 2) for key, value in rows[submaps].items()})
    if picture := os.environ.get("REVISIT_GROWTH_PICTURE"):
        draw(rows, Path(picture))
    assert all(min(row.values()) > 0 for row in rows.values())

"""What a submap costs a worker, by stage, in CPU time of its process: robots that send described scans in one town.

REVISIT_COST_ROBOTS (2) drive REVISIT_COST_METRES (30) each round one block (simulated, 64 beams). Their scans go into a
store as they would come, and one worker does the jobs that are due, in this process and without a gateway: a stage is
the time of the whole process between its beginning and its end, without the stages inside it.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from concurrent.futures import Future
from functools import wraps
from pathlib import Path

import pytest

import revisit.core.pipeline as pipeline
import revisit.service.features.ingest.rows as rows
import revisit.service.features.recognition.job as job
from revisit.core.implicit_map import NeuralMap
from revisit.core.place import Place
from revisit.service.adapters.core_map_merger import CoreMapMerger
from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.adapters.core_recogniser import CoreRecogniser, load_recogniser
from revisit.service.adapters.core_tile_maker import CoreTileMaker
from revisit.service.composition import _new_index
from revisit.service.context import ServiceContext
from revisit.service.domain.identity import SessionKey
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.index.place_memory import PlaceMemory
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.settings import Settings
from revisit.service.use_cases import UseCases
from tests.support.figures import publish
from tests.support.made_database import made_database
from tests.support.recorded_drive import SPEED_MPS, Lap, recorded_drive
from tests.support.service_world import TENANT
from tests.support.stepped_clock import PassingClock

ROBOTS = int(os.environ.get("REVISIT_COST_ROBOTS", "2"))
METRES = float(os.environ.get("REVISIT_COST_METRES", "30"))
SHORT_M = 60.0
"""Robots that drive no farther follow each other a metre apart on the beginning of the round."""
BLOCK_M = 85.0
BLAS_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(
        any(os.environ.get(name) != "1" for name in BLAS_THREADS),
        reason=f"a worker's libraries have one thread: set {', '.join(BLAS_THREADS)} to 1, as make does",
    ),
]

STAGES = {
    (pipeline, "fit_implicit_map"): "describe: implicit map",
    (pipeline, "place_flags"): "describe: flags",
    (pipeline, "scan_disagreement"): "describe: disagreement",
    (pipeline, "extract_surface"): "describe: surface",
    (pipeline, "segment_clusters"): "describe: clusters",
    (pipeline, "describe_bev"): "describe: bird's-eye view",
    (pipeline, "describe_spectra"): "describe: spectra",
    (pipeline, "extract_place"): "describe: place",
    (CoreRecogniser, "describe"): "describe: the rest",
    (NeuralMap, "to_blob"): "neural map coded",
    (Place, "to_blob"): "place coded",
    (Place, "from_blob"): "places decoded",
    (rows, "unpack_cloud"): "scans decoded",
    (job.SubmapDescriptionJob, "_upright"): "scans placed",
    (CoreRecogniser, "inspect"): "inspection",
    (PlaceMemory, "recall"): "recall",
    (CoreRecogniser, "verify"): "verification",
    (job, "accept"): "acceptance",
    (EarlyCorrections, "update"): "early corrections",
    (FileBlobStore, "get"): "blobs read",
    (FileBlobStore, "put"): "blobs written",
    (SqliteTransactions, "read"): "statements",
    (SqliteTransactions, "read_here"): "statements",
    (SqliteTransactions, "write"): "statements",
}


class StageClock:
    """CPU seconds by stage while it is on; the jobs that maps are optimised by are one stage each."""

    def __init__(self) -> None:
        self.spent_s, self.on = Counter[str](), False
        self._inside: list[float] = []

    def call(self, stage: str, function, *arguments, **named):
        """The result of a function, whose time is the stage's. A future is waited for."""
        if not self.on:
            return function(*arguments, **named)
        began_s = time.process_time()
        self._inside.append(0.0)
        try:
            result = function(*arguments, **named)
            if isinstance(result, Future):
                result.exception()
            return result
        finally:
            took_s = time.process_time() - began_s
            self.spent_s[stage] += took_s - self._inside.pop()
            if self._inside:
                self._inside[-1] += took_s

    def watch(self, monkeypatch, owner, name: str, stage: str) -> None:
        """Count the calls of a function or method as a stage."""
        raw = vars(owner)[name]
        function = raw.__func__ if isinstance(raw, classmethod) else raw

        @wraps(function)
        def run(*arguments, **named):
            return self.call(stage, function, *arguments, **named)

        monkeypatch.setattr(owner, name, classmethod(run) if isinstance(raw, classmethod) else run)


@pytest.fixture
def context(tmp_path):
    """A store, and the parts of a worker."""
    policy, clock = Settings(home=tmp_path).policy, PassingClock()
    database = made_database(tmp_path / "revisit.db")
    transactions = SqliteTransactions(database, checkpoints=True, lease_ms=policy.lease_ms, clock=clock)
    index = PlaceVectorIndex(_new_index, None, saved_from=None)
    yield ServiceContext(transactions, FileBlobStore(tmp_path / "blobs"), index, clock, policy)
    transactions.close()


def laps(tmp_path_factory) -> list[Lap]:
    folder = Path(os.environ.get("REVISIT_ROBOTS_DRIVE") or tmp_path_factory.mktemp("drive"))
    short = METRES <= SHORT_M and ROBOTS * METRES <= 2 * SHORT_M
    drive = recorded_drive(folder, 500 if short else None, BLOCK_M, described=True)
    apart = 1 if short else len(drive) // ROBOTS
    return [Lap(drive, robot, robot * apart) for robot in range(ROBOTS)]


def work_off(context: ServiceContext, runner, clock: StageClock) -> Counter[str]:
    """Do the jobs that are due; how many of each kind."""
    done = Counter[str]()
    clock.on = True
    while (lease := context.transactions.write(lambda uow: uow.queue.claim("worker")).result()) is not None:
        kind = str(lease.job.kind)
        of_map = kind != "DESCRIBE_SUBMAP"
        if of_map:
            began_s, before = time.process_time(), Counter(clock.spent_s)
        clock.call("the rest of the job", runner.run, lease)
        if of_map:
            clock.spent_s = before
            clock.spent_s[kind] += time.process_time() - began_s
        done[kind] += 1
    clock.on = False
    return done


async def test_what_a_submap_costs_a_worker(context, tmp_path_factory, monkeypatch):
    driving, use_cases, clock = laps(tmp_path_factory), UseCases.over(context, "test"), StageClock()
    await use_cases.maps.create(TENANT, CreateMap("town"))
    for lap in driving:
        await use_cases.sessions.create(TENANT, CreateSession("town", f"r{lap.robot}"))
    runner = context.jobs(load_recogniser(), CoreMapOptimiser(), CoreMapMerger(), CoreTileMaker())
    for (owner, name), stage in STAGES.items():
        clock.watch(monkeypatch, owner, name, stage)
    due = sorted((lap.way_m(n), lap.robot, n) for lap in driving for n in range(lap.scans_within(METRES)))
    began_ms, done, total_s = context.clock.ms, Counter[str](), 0.0
    for way_m, robot, number in due:
        context.clock.ms = max(context.clock.ms, began_ms + int(1000 * way_m / SPEED_MPS))
        cloud, T_odom_sensor = driving[robot].scan(number)
        key, encoded = SessionKey("town", f"r{robot}"), EncodedCloud(cloud.data, cloud.content_type)
        stamp_ns = int(1e9 * way_m / SPEED_MPS) + 1
        scan = AppendScan(key, number + 1, stamp_ns, T_odom_sensor, encoded, travelled_m=way_m)
        await use_cases.scans.append(TENANT, scan)
        began_s = time.process_time()
        done += work_off(context, runner, clock)
        total_s += time.process_time() - began_s
    submaps = done["DESCRIBE_SUBMAP"]
    told = {stage: round(1e3 * s / submaps, 1) for stage, s in clock.spent_s.most_common()}
    figures = {"jobs": dict(done), "cpu_ms_a_submap": round(1e3 * total_s / submaps, 1), "stages": told}
    publish("worker_cost", robots=ROBOTS, metres=METRES, load=os.getloadavg()[0], **figures)
    states = context.transactions.read_here(lambda uow: uow.submaps.distinct(TENANT, "state", map_id="town"))
    assert list(states) == ["DESCRIBED"] and submaps >= ROBOTS
    assert 0.9 * total_s <= sum(clock.spent_s.values()) <= total_s

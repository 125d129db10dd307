"""What one process of the service is built from: its adapters, its rules and its shared state."""

from __future__ import annotations

import secrets
import threading
from dataclasses import dataclass, field
from functools import cached_property

from revisit.service.application.capacity.backlog import Backlog
from revisit.service.application.capacity.byte_budget import ByteBudget
from revisit.service.application.capacity.call_pace import CallPace
from revisit.service.application.capacity.in_flight import DECODERS, InFlight
from revisit.service.application.capacity.storage_quota import StorageQuota
from revisit.service.application.catalogue.blob_references import BlobCollector
from revisit.service.application.catalogue.erasure import Erasure
from revisit.service.application.catalogue.mesh_making import MeshMaking
from revisit.service.application.contract.blobs import BlobStore
from revisit.service.application.contract.clock import Clock
from revisit.service.application.contract.disk import DiskSpace, UnlimitedDisk
from revisit.service.application.contract.index import VectorIndex
from revisit.service.application.contract.job_context import JobContext
from revisit.service.application.contract.map_merger import MapMerger
from revisit.service.application.contract.map_optimiser import MapOptimiser
from revisit.service.application.contract.map_tiles import TileMaker
from revisit.service.application.contract.policy import Policy
from revisit.service.application.contract.recogniser import PlaceRecogniser
from revisit.service.application.contract.states import OperationKind
from revisit.service.application.contract.storage import Storage
from revisit.service.application.contract.transactions import Transactions
from revisit.service.application.housekeeping.index_keeping import IndexHealth, IndexKeeper
from revisit.service.application.ingest.clouds import CloudDecoder
from revisit.service.application.ingest.open_streams import OpenStreams
from revisit.service.application.mapping.early_corrections import EarlyCorrections
from revisit.service.application.mapping.map_filing import MapFiling
from revisit.service.application.mapping.merging import MapMerging
from revisit.service.application.mapping.optimisation import MapOptimisation
from revisit.service.application.mapping.tile_making import TileMaking
from revisit.service.application.query.place_memory import PlaceMemory
from revisit.service.application.recognise.cloud_query_job import CloudQueryJob
from revisit.service.application.recognise.description_job import SubmapDescriptionJob
from revisit.service.application.recognise.job_runner import JobRunner
from revisit.service.application.recognise.loop_recall_job import LoopRecallJob
from revisit.service.application.recognise.proposed_loop_job import ProposedLoopJob


@dataclass(frozen=True)
class Installation:
    """Given to those who build; a use case is given only those of its parts that it uses."""

    transactions: Transactions
    blobs: BlobStore
    index: VectorIndex
    clock: Clock
    policy: Policy
    stopping: threading.Event = field(default_factory=threading.Event)
    in_flight: InFlight = field(default_factory=InFlight)
    pace: CallPace = field(default_factory=CallPace)
    disk: DiskSpace = field(default_factory=UnlimitedDisk)
    index_health: IndexHealth = field(default_factory=IndexHealth)
    open_streams: OpenStreams = field(default_factory=OpenStreams)
    budget: ByteBudget = field(default_factory=ByteBudget)
    secret: bytes = field(default_factory=lambda: secrets.token_bytes(32))
    """Known to nobody else: makes the tokens of pages unreadable."""
    decoder: CloudDecoder = field(default_factory=lambda: CloudDecoder(DECODERS))

    @cached_property
    def storage(self) -> Storage:
        """Transactions and blobs, from the event loop."""
        return Storage(self.transactions, self.blobs)

    @cached_property
    def memory(self) -> PlaceMemory:
        """Searches in the index."""
        return PlaceMemory(self.transactions, self.index)

    @cached_property
    def backlog(self) -> Backlog:
        """The limit of waiting jobs."""
        return Backlog(self.storage, self.in_flight, self.policy.max_queued_jobs)

    @cached_property
    def erasure(self) -> Erasure:
        """What deletes the rows of deleted sessions and maps."""
        return Erasure(self.storage, BlobCollector(self.storage), self.clock)

    @cached_property
    def quota(self) -> StorageQuota | None:
        """The limit of what a tenant stores, if there is one."""
        most_bytes = self.policy.tenant_storage_bytes
        return None if most_bytes is None else StorageQuota(self.storage, most_bytes)

    def jobs(
        self, recogniser: PlaceRecogniser, optimiser: MapOptimiser, merger: MapMerger, tiler: TileMaker
    ) -> JobRunner:
        """The jobs of a worker; `recogniser`, `optimiser`, `merger` and `tiler` are the method."""
        context = JobContext(self.transactions, self.blobs, self.clock, self.policy)
        early = EarlyCorrections(self.transactions, self.clock, self.policy, optimiser)
        queries, tiles = CloudQueryJob(context, self.memory, recogniser), TileMaking(context, tiler)
        jobs = {
            OperationKind.DESCRIBE_SUBMAP: SubmapDescriptionJob(context, self.memory, recogniser, early).run,
            OperationKind.SEARCH_CLOUD: queries.search,
            OperationKind.LOCALIZE: queries.localise,
            OperationKind.OPTIMISE_MAP: MapOptimisation(context, optimiser, recogniser, early).run,
            OperationKind.VERIFY_LOOP: ProposedLoopJob(context, recogniser, early).run,
            OperationKind.MERGE_MAP: MapMerging(context, recogniser, merger).run,
            OperationKind.MAKE_TILE: tiles.make,
            OperationKind.MEASURE_MAP: tiles.measure,
            OperationKind.PUBLISH_MAP: MapFiling(context).run,
            OperationKind.RECALL_LOOPS: LoopRecallJob(context, recogniser, early).run,
            OperationKind.MAKE_MESH: MeshMaking(context, recogniser).run,
        }
        return JobRunner(context, jobs)

    def index_keeper(self) -> IndexKeeper:
        """What loads the index and compares it with the database. From now on the service is not ready until then."""
        return IndexKeeper(self.storage, self.index, self.memory, self.index_health, self.disk)

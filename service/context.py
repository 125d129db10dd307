"""The context of one process of the service: adapters, rules and shared state."""

from __future__ import annotations

import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from revisit.service.capacity.backlog import Backlog
from revisit.service.capacity.budget import GatewayShare
from revisit.service.capacity.byte_budget import ByteBudget
from revisit.service.capacity.call_pace import CallPace
from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import DECODERS
from revisit.service.capacity.storage_quota import StorageQuota
from revisit.service.domain.policy import Policy
from revisit.service.domain.states import OperationKind
from revisit.service.features.catalogue.job import MeshMaking
from revisit.service.features.changes.job import ChangeFinding
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.deletion.erasure import Erasure
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.features.index.keeping import IndexHealth, IndexKeeper
from revisit.service.features.index.place_memory import PlaceMemory
from revisit.service.features.ingest.clouds import CloudDecoder
from revisit.service.features.merging.job import MapMerging
from revisit.service.features.operations.job_runner import JobRunner
from revisit.service.features.optimisation.anchor_preview import AnchorPreview
from revisit.service.features.optimisation.job import MapOptimisation
from revisit.service.features.publishing.job import MapFiling
from revisit.service.features.recognition.job import SubmapDescriptionJob
from revisit.service.features.recognition.loop_recall_job import LoopRecallJob
from revisit.service.features.recognition.proposed_loop_job import ProposedLoopJob
from revisit.service.features.relocalisation.job import RelocalisationJob
from revisit.service.features.retention.run import Retention
from revisit.service.features.search.job import CloudQueryJob
from revisit.service.features.tiles.job import TileMaking
from revisit.service.ports.blobs import BlobOutage, BlobStore, NoOutage
from revisit.service.ports.clock import Clock
from revisit.service.ports.disk import DiskSpace, UnlimitedDisk
from revisit.service.ports.index import VectorIndex
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.map_merger import MapMerger
from revisit.service.ports.map_optimiser import MapOptimiser
from revisit.service.ports.map_tiles import TileMaker
from revisit.service.ports.place_search import SearchElsewhere
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import Transactions


@dataclass(frozen=True)
class ServiceContext:
    """Given to builders; a use case gets only the parts that it uses."""

    transactions: Transactions
    blobs: BlobStore
    index: VectorIndex
    clock: Clock
    policy: Policy
    stopping: threading.Event = field(default_factory=threading.Event)
    share: GatewayShare = field(default_factory=GatewayShare)
    in_flight: InFlight = field(default_factory=InFlight)
    pace: CallPace = field(default_factory=CallPace)
    disk: DiskSpace = field(default_factory=UnlimitedDisk)
    blob_outage: BlobOutage = field(default_factory=NoOutage)
    index_health: IndexHealth = field(default_factory=IndexHealth)
    budget: ByteBudget = field(default_factory=ByteBudget)
    elsewhere: Callable[[CaughtUpIndex], SearchElsewhere] | None = None
    """Makes the search in other processes, as long as there are any; None for in this process alone."""
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
        return PlaceMemory(self.transactions, self.search_elsewhere or self.own_index)

    @cached_property
    def search_elsewhere(self) -> SearchElsewhere | None:
        """The search in other processes, where there may be any."""
        return None if self.elsewhere is None else self.elsewhere(self.own_index)

    @cached_property
    def own_index(self) -> CaughtUpIndex:
        """The index of this process."""
        return CaughtUpIndex(self.transactions, self.index)

    @cached_property
    def backlog(self) -> Backlog:
        """The limit of waiting jobs."""
        return Backlog(self.storage, self.in_flight, self.policy.max_queued_jobs)

    @cached_property
    def erasure(self) -> Erasure:
        """The eraser of deleted sessions and maps."""
        return Erasure(self.storage, self.clock)

    @cached_property
    def retention(self) -> Retention:
        """Brings maps to their policies of retention."""
        return Retention(self.storage, self.clock, self.policy)

    @cached_property
    def quota(self) -> StorageQuota | None:
        """The storage quota of a tenant, if there is one."""
        most_bytes = self.policy.tenant_storage_bytes
        return None if most_bytes is None else StorageQuota(self.storage, most_bytes, self.share)

    def jobs(
        self, recogniser: PlaceRecogniser, optimiser: MapOptimiser, merger: MapMerger, tiler: TileMaker
    ) -> JobRunner:
        """The jobs of a worker; `recogniser`, `optimiser`, `merger` and `tiler` are the method."""
        context = JobContext(self.transactions, self.blobs, self.clock, self.policy)
        early = EarlyCorrections(self.transactions, self.clock, self.policy, optimiser)
        queries, tiles = CloudQueryJob(context, self.memory, recogniser), TileMaking(context, tiler)
        optimisation = MapOptimisation(context, optimiser, merger, recogniser, early)
        jobs = {
            OperationKind.DESCRIBE_SUBMAP: SubmapDescriptionJob(context, self.memory, recogniser, early).run,
            OperationKind.SEARCH_CLOUD: queries.search,
            OperationKind.LOCALIZE: queries.localise,
            OperationKind.RELOCALISE: RelocalisationJob(context, self.memory, recogniser).run,
            OperationKind.OPTIMISE_MAP: optimisation.run,
            OperationKind.PREVIEW_ANCHORS: AnchorPreview(context, optimisation).run,
            OperationKind.VERIFY_LOOP: ProposedLoopJob(context, recogniser, early).run,
            OperationKind.MERGE_MAP: MapMerging(context, recogniser, optimiser, merger).run,
            OperationKind.MAKE_TILE: tiles.make,
            OperationKind.MEASURE_MAP: tiles.measure,
            OperationKind.FIND_CHANGES: ChangeFinding(context, tiler).run,
            OperationKind.PUBLISH_MAP: MapFiling(context).run,
            OperationKind.RECALL_LOOPS: LoopRecallJob(context, recogniser, early).run,
            OperationKind.MAKE_MESH: MeshMaking(context, recogniser).run,
        }
        return JobRunner(context, jobs)

    def index_keeper(self) -> IndexKeeper:
        """The loader of the index, which also compares it with the database. From now on the service is not ready until
        then.
        """
        search = self.search_elsewhere

        def holds(_: int) -> bool:
            return search is None or not search.anywhere()

        return IndexKeeper(self.storage, self.index, self.own_index, self.index_health, self.disk, holds)

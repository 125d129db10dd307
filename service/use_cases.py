"""The use cases of `features`, a folder a feature. REST and gRPC call these and nothing else.

Every call takes the tenant first; a resource of another tenant is NotFound. Calls that change something return after
the commit; a caller that goes away does not undo it. Errors are `core.errors.RevisitError` subclasses.
"""

from __future__ import annotations

from dataclasses import dataclass

from revisit.service.capacity.admission import Admission
from revisit.service.capacity.backlog import JobPosting
from revisit.service.capacity.byte_budget import ByteBudget
from revisit.service.capacity.charged_work import ChargedWork
from revisit.service.context import ServiceContext
from revisit.service.domain.identity import DEFAULT_TENANT, SessionKey, SubmapKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.features.anchors.calls import Anchors
from revisit.service.features.audit.calls import AuditLog
from revisit.service.features.catalogue.maps import Maps
from revisit.service.features.catalogue.meshes import SubmapMeshes
from revisit.service.features.catalogue.robots import Robots
from revisit.service.features.catalogue.sessions import Sessions
from revisit.service.features.catalogue.submaps import Submaps
from revisit.service.features.changes.calls import MapChanges
from revisit.service.features.corrections.calls import Corrections
from revisit.service.features.events.calls import Events
from revisit.service.features.ingest.calls import Scans
from revisit.service.features.ingest.posting import SubmapPosting
from revisit.service.features.keys.admission import Access, AccessRules
from revisit.service.features.keys.calls import ApiKeys
from revisit.service.features.loops.calls import Loops
from revisit.service.features.loops.decisions import LoopDecisions
from revisit.service.features.loops.keypoints import LoopKeypointReading
from revisit.service.features.merging.calls import MapMerges
from revisit.service.features.operations.calls import Operations
from revisit.service.features.operations.dead_letters import DeadLetters
from revisit.service.features.operations.worker_answers import WorkerAnswers
from revisit.service.features.optimisation.calls import MapVersions
from revisit.service.features.plans.calls import Plans
from revisit.service.features.publishing.calls import MapFiles
from revisit.service.features.radio.calls import Radio
from revisit.service.features.relocalisation.calls import Conversations
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Lists, PageTokens
from revisit.service.features.retention.calls import MapRetentions
from revisit.service.features.search.calls import Searches
from revisit.service.features.tiles.calls import MapTiles
from revisit.service.features.upkeep.calls import System
from revisit.service.features.waiting.event_tail import EventTail
from revisit.service.features.waiting.freshness import ReadYourWrites
from revisit.service.features.webhooks.calls import Webhooks


@dataclass(frozen=True)
class UseCases:
    """Everything a transport can ask for."""

    maps: Maps
    robots: Robots
    sessions: Sessions
    anchors: Anchors
    radio: Radio
    scans: Scans
    posting: SubmapPosting
    submaps: Submaps
    searches: Searches
    conversations: Conversations
    loops: Loops
    loop_keypoints: LoopKeypointReading
    operations: Operations
    events: Events
    webhooks: Webhooks
    map_versions: MapVersions
    map_merges: MapMerges
    map_tiles: MapTiles
    map_changes: MapChanges
    map_files: MapFiles
    plans: Plans
    retention: MapRetentions
    corrections: Corrections
    loop_decisions: LoopDecisions
    dead_letters: DeadLetters
    system: System
    admission: Admission
    access: Access
    keys: ApiKeys
    audit: AuditLog
    budget: ByteBudget

    @classmethod
    def over(cls, of: ServiceContext, version: str, rules: AccessRules = AccessRules()) -> UseCases:
        """All use cases of an installation; `version` is the product's."""
        admission = Admission(of.stopping, of.disk, of.in_flight, of.backlog, of.quota)
        lists = Lists(of.storage, of.in_flight, PageTokens(of.secret))
        jobs = JobPosting(of.backlog, of.clock, of.policy)
        context = CallContext(of.storage, lists, admission, jobs, of.clock, of.policy)
        operations, audit, work = Operations(context), AuditLog(of.storage, of.clock), ChargedWork(of.in_flight)
        tail, writes = EventTail(of.storage, admission), ReadYourWrites(of.storage, admission)
        answers = WorkerAnswers(context, operations)
        return cls(
            maps=Maps(context, of.erasure, of.index),
            robots=Robots(context),
            sessions=Sessions(context, of.erasure),
            anchors=Anchors(context, work),
            radio=Radio(context),
            scans=Scans(context, of.decoder, of.in_flight),
            posting=SubmapPosting(context, of.decoder),
            submaps=Submaps(context, work, SubmapMeshes(context, answers)),
            searches=Searches(context, of.decoder, of.memory, answers, writes),
            conversations=Conversations(context, of.decoder, answers, of.in_flight),
            loops=Loops(context, tail, writes),
            loop_keypoints=LoopKeypointReading(context),
            operations=operations,
            events=Events(context, tail),
            webhooks=Webhooks(context),
            map_versions=MapVersions(context),
            map_merges=MapMerges(context, of.erasure),
            map_tiles=MapTiles(context, operations, work),
            map_changes=MapChanges(context, operations, work),
            map_files=MapFiles(context),
            plans=Plans(context, work),
            retention=MapRetentions(context),
            corrections=Corrections(context, tail),
            loop_decisions=LoopDecisions(context),
            dead_letters=DeadLetters(context, of.backlog),
            system=System(context, of.disk, of.blob_outage, of.index_health, version),
            admission=admission,
            access=Access(of.storage, audit, of.clock, rules, of.pace),
            keys=ApiKeys(of.storage, of.clock),
            audit=audit,
            budget=of.budget,
        )


__all__ = ["DEFAULT_TENANT", "Policy", "ServiceContext", "SessionKey", "SubmapKey", "TenantId", "UseCases"]

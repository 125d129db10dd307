"""Use cases, one module per noun, and the ports they need. REST and gRPC call these and nothing else.

Every call takes the tenant first; a resource of another tenant is NotFound. Calls that change something return after
the commit; a caller that goes away does not undo it. Errors are `core.errors.RevisitError` subclasses.
"""

from __future__ import annotations

from dataclasses import dataclass

from revisit.service.application.access.admission import Access, AccessRules
from revisit.service.application.access.api_keys import ApiKeys
from revisit.service.application.access.audit import AuditLog
from revisit.service.application.catalogue.loops import Loops
from revisit.service.application.catalogue.maps import Maps
from revisit.service.application.catalogue.robots import Robots
from revisit.service.application.catalogue.sessions import Sessions
from revisit.service.application.catalogue.submaps import Submaps
from revisit.service.application.contract.context import Context, Policy
from revisit.service.application.contract.identity import DEFAULT_TENANT, SessionKey, SubmapKey, TenantId
from revisit.service.application.housekeeping.dead_letters import DeadLetters
from revisit.service.application.housekeeping.system import System
from revisit.service.application.ingest.scans import Scans
from revisit.service.application.query.operations import Operations
from revisit.service.application.query.searches import Searches


@dataclass(frozen=True)
class UseCases:
    """Everything a transport can ask for, by noun."""

    maps: Maps
    robots: Robots
    sessions: Sessions
    scans: Scans
    submaps: Submaps
    searches: Searches
    loops: Loops
    operations: Operations
    dead_letters: DeadLetters
    system: System
    access: Access
    keys: ApiKeys
    audit: AuditLog

    @classmethod
    def over(cls, context: Context, version: str, rules: AccessRules = AccessRules()) -> UseCases:
        """All use cases over the same ports; `version` is the product's."""
        operations = Operations(context)
        return cls(
            maps=Maps(context),
            robots=Robots(context),
            sessions=Sessions(context),
            scans=Scans(context),
            submaps=Submaps(context),
            searches=Searches(context, operations),
            loops=Loops(context),
            operations=operations,
            dead_letters=DeadLetters(context),
            system=System(context, version),
            access=Access(context, rules),
            keys=ApiKeys(context),
            audit=AuditLog(context),
        )


__all__ = ["DEFAULT_TENANT", "Context", "Policy", "SessionKey", "SubmapKey", "TenantId", "UseCases"]

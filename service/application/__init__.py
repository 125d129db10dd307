"""Use cases, one module per noun, and the ports they need. REST and gRPC call these and nothing else.

Every call takes the tenant first; a resource of another tenant is NotFound. Calls that change something return after
the commit; a caller that goes away does not undo it. Errors are `core.errors.RevisitError` subclasses.
"""

from __future__ import annotations

from dataclasses import dataclass

from service.application.access import Access, AccessRules
from service.application.api_keys import ApiKeys
from service.application.audit import AuditLog
from service.application.context import Context, Policy
from service.application.dead_letters import DeadLetters
from service.application.identity import DEFAULT_TENANT, SessionKey, SubmapKey, TenantId
from service.application.loops import Loops
from service.application.maps import Maps
from service.application.operations import Operations
from service.application.robots import Robots
from service.application.scans import Scans
from service.application.searches import Searches
from service.application.sessions import Sessions
from service.application.submaps import Submaps
from service.application.system import System


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

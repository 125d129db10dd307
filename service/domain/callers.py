"""Callers of requests: scopes, and the tenant whose resources they may see."""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass

import structlog

from revisit.api.scopes import Scope
from revisit.service.domain.errors import PermissionDenied, Unauthenticated
from revisit.service.domain.identity import DEFAULT_TENANT, TenantId


@dataclass(frozen=True)
class Caller:
    """A tenant's client with a verified credential. `name` is its name in the audit log."""

    tenant: TenantId
    name: str
    scopes: frozenset[Scope]

    def require_any(self, scopes: frozenset[Scope]) -> None:
        """Raises PermissionDenied unless the caller has one of `scopes`."""
        if not self.scopes & scopes:
            wanted = " or ".join(sorted(scopes))
            raise PermissionDenied(f"this call needs the scope {wanted}")


ANYONE = Caller(DEFAULT_TENANT, "anyone", frozenset(Scope))
"""The caller while authentication is off."""

LOCAL_OPERATOR = "operator"
"""The command line, which works on the database without the service."""

_CALLER: ContextVar[Caller] = ContextVar("caller")


def enter(caller: Caller) -> None:
    """From here on this request is `caller`'s; each line of the log that it causes says so."""
    _CALLER.set(caller)
    structlog.contextvars.bind_contextvars(tenant=caller.tenant, caller=caller.name)


def current_tenant() -> TenantId:
    """The tenant of the request. Raises Unauthenticated where nobody was admitted."""
    caller = _CALLER.get(None)
    if caller is None:
        raise Unauthenticated
    return caller.tenant


def current_tenant_or_none() -> TenantId | None:
    """As `current_tenant`; None where nobody was admitted."""
    caller = _CALLER.get(None)
    return None if caller is None else caller.tenant


def current_actor() -> str:
    """The actor of this request's changes."""
    caller = _CALLER.get(None)
    return LOCAL_OPERATOR if caller is None else caller.name

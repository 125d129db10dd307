"""Storeys: sessions on different ones are never compared (docs/decisions/0281).

A storey is the level of a building, by its name. A sensor cannot tell storeys of one plan apart.
A session without a storey is compared with all others.
"""

from __future__ import annotations

from revisit.service.domain.identity import TenantId
from revisit.service.ports.transactions import UnitOfWork


def comparable_sessions(uow: UnitOfWork, tenant: TenantId, map_id: str, storey: str | None) -> frozenset[int] | None:
    """The numbers of the sessions of a map that may show a place of `storey`; None where all may.

    A session that is created later is not among them: read it again where later ones must be.
    """
    if storey is None:
        return None
    return frozenset(
        number
        for its in (storey, None)
        for number in uow.sessions.distinct(tenant, "number", map_id=map_id, storey=its)
    )


def storey_of(uow: UnitOfWork, tenant: TenantId, map_id: str, session_id: str) -> str | None:
    """The storey of a session; None where nobody said it, or the session is gone."""
    session = uow.sessions.get(tenant, map_id, session_id)
    return None if session is None else session.storey

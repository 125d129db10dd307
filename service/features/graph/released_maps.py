"""Retired submaps whose neural maps retention has removed: poses and loops stay, surfaces are made without them."""

from __future__ import annotations

from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import SubmapState
from revisit.service.ports.transactions import UnitOfWork


def released_maps(uow: UnitOfWork, tenant: TenantId, map_id: str) -> frozenset[int]:
    """The numbers of the retired submaps of a map that have no neural map any more."""
    gone = {"map_id": map_id, "state": SubmapState.RETIRED.value, "neural_map_sha256": None}
    return frozenset(uow.submaps.distinct(tenant, "number", **gone))

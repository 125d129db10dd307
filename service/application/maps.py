"""Maps: the places a fleet shares; every session, submap and loop closure belongs to one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from service.application.identity import TenantId
from service.application.paging import Page, PageRequest


@dataclass(frozen=True)
class CreateMap:
    """A new map. `tau_m`, `stride_m` and `min_index_gap` override the service's configuration where given."""

    map_id: str
    display_name: str = ""
    tau_m: float | None = None
    stride_m: float | None = None
    min_index_gap: int | None = None


@dataclass(frozen=True)
class MapView:
    """A map as clients see it; `tau_m`, `stride_m` and `min_index_gap` are the values in force."""

    map_id: str
    display_name: str
    tau_m: float
    stride_m: float
    min_index_gap: int
    session_count: int
    submap_count: int
    created_at_ns: int


@dataclass(frozen=True)
class CreatedMap:
    """The map, and whether an earlier identical request had created it."""

    map: MapView
    replay: bool


class Maps(Protocol):
    """Create, get, list and delete maps."""

    async def create(self, tenant: TenantId, command: CreateMap) -> CreatedMap:
        """Create a map. Raises BadField; AlreadyExists where the id is taken by other content."""
        ...

    async def get(self, tenant: TenantId, map_id: str) -> MapView:
        """Raises NotFound."""
        ...

    async def list(self, tenant: TenantId, page: PageRequest) -> Page[MapView]:
        """The tenant's maps, oldest first."""
        ...

    async def delete(self, tenant: TenantId, map_id: str) -> None:
        """Delete a map with everything in it. Raises NotFound."""
        ...

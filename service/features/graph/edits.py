"""Changes that make a part of a map's pose graph void: an optimisation under way reads the graph again."""

from __future__ import annotations

from dataclasses import replace

from revisit.service.domain.identity import TenantId
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork


def note_edit(uow: UnitOfWork, tenant: TenantId, map_id: str) -> None:
    """A loop has changed, or a submap or session is gone: corrections ahead of a version are forgotten.

    Additions need no note. Raises NotFound.
    """
    record = require_map(uow, tenant, map_id, hold=True)
    uow.early_corrections.delete(tenant, map_id=map_id)
    uow.maps.replace(replace(record, graph_edits=record.graph_edits + 1))

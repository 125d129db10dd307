"""Webhooks in an SQL database: each has a position in every map that it is told of."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Select,
    and_,
    bindparam,
    delete,
    func,
    insert,
    literal,
    or_,
    select,
    update,
)

from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import WebhookState
from revisit.service.domain.webhooks import News, WebhookRecord
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.map_counters import FORMER
from revisit.service.engines.sql.presence import present
from revisit.service.engines.sql.repositories import Scalar, SqlRepository


class SqlWebhooks(SqlRepository[WebhookRecord]):
    """`WebhookRepository`."""

    def add(self, record: WebhookRecord) -> WebhookRecord:
        """See `WebhookRepository`."""
        added = super().add(record)
        counters, positions = tables.map_counters.c, tables.webhook_positions
        columns = [column.name for column in positions.columns]
        own = or_(literal(added.map_id is None), counters.map_id == (added.map_id or FORMER))
        told = select(literal(added.number), counters.map_id, counters.tenant, counters.events)
        told = told.where(counters.tenant == added.tenant, counters.map_id != FORMER, own)
        self._connection.execute(insert(positions).from_select(columns, told))
        return added

    def delete(self, tenant: TenantId, **equals: Scalar) -> int:
        """See `Repository`."""
        positions = tables.webhook_positions
        for webhook in self.find(tenant, after=0, limit=None, **equals):
            self._connection.execute(delete(positions).where(positions.c.webhook_number == webhook.number))
        return super().delete(tenant, **equals)

    def due(self, now_ns: int) -> list[WebhookRecord]:
        """See `WebhookRepository`."""
        webhooks = tables.webhooks.c
        is_due = and_(webhooks.state == WebhookState.ENABLED.value, webhooks.due_at_ns <= now_ns)
        query = select(tables.webhooks).where(is_due, webhooks.number.in_(_with_news(webhooks.number)))
        return self._readable(self._connection.execute(query.order_by(webhooks.due_at_ns, webhooks.number)))

    def news(self, webhook: WebhookRecord) -> dict[str, News]:
        """See `WebhookRepository`."""
        rows = self._connection.execute(_news(), {"its_number": webhook.number})
        # Those of a map with damaged counters wait.
        return {row.map_id: News(row.position, row.events) for row in rows if isinstance(row.events, int)}

    def tell(self, webhook: WebhookRecord, told: Mapping[str, int]) -> None:
        """See `WebhookRepository`."""
        positions = tables.webhook_positions
        for map_id, number in told.items():
            own = and_(positions.c.webhook_number == webhook.number, positions.c.map_id == map_id)
            if self._connection.execute(update(positions).where(own).values(told=number)).rowcount == 0:
                row = {"webhook_number": webhook.number, "map_id": map_id, "tenant": webhook.tenant, "told": number}
                self._connection.execute(insert(positions), row)


@cache
def _news() -> Select[Any]:
    """The maps with news for webhook `its_number`, with their last number and its position."""
    told = func.coalesce(tables.webhook_positions.c.told, 0).label("position")
    counters = tables.map_counters.c
    query = _with_news(counters.map_id, counters.events, told)
    return query.where(tables.webhooks.c.number == bindparam("its_number"))


def _with_news(*columns: ColumnElement[Any]) -> Select[Any]:
    """These columns of webhooks with the counters of the maps that have news for them."""
    webhooks, counters, positions = tables.webhooks.c, tables.map_counters, tables.webhook_positions
    its_maps = or_(webhooks.map_id.is_(None), webhooks.map_id == counters.c.map_id)
    of_tenant = and_(counters.c.tenant == webhooks.tenant, counters.c.map_id != FORMER, its_maps)
    own = and_(positions.c.webhook_number == webhooks.number, positions.c.map_id == counters.c.map_id)
    joined = tables.webhooks.join(counters, of_tenant).outerjoin(positions, own)
    return (
        select(*columns)
        .select_from(joined)
        .where(counters.c.events > func.coalesce(positions.c.told, 0), present(counters))
    )

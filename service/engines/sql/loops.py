"""Loop closures in SQL, also those of several submaps at once."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

from sqlalchemy import BigInteger, BindParameter, Select, and_, bindparam, func, or_, select, text, type_coerce

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import LoopRecord
from revisit.service.domain.states import LoopState
from revisit.service.engines.sql import tables
from revisit.service.engines.sql.packed_columns import MeasuredCovariance
from revisit.service.engines.sql.repositories import Scalar, SqlRepository, matches, of_tenant, seen
from revisit.service.ports.repositories import LoopEnds


class SqlLoops(SqlRepository[LoopRecord]):
    """`LoopRepository`."""

    def accepted(
        self, tenant: TenantId, map_id: str, *, after: int = 0, limit: int | None = None, **equals: Scalar
    ) -> list[LoopRecord]:
        """See `LoopRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, **equals})
        query = _accepted(self._rows_where(asked), limited=limit is not None)
        rows = self._connection.execute(query, {**asked, "after_seq": after, "at_most": limit})
        return [self._of(row) for row in rows]

    def measured(self, tenant: TenantId, map_id: str, *, after: int, limit: int) -> list[LoopRecord]:
        """See `LoopRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, "state": LoopState.ACCEPTED.value})
        query = _measured(self._sees_all, tuple(asked))
        rows = self._connection.execute(query, {**asked, "after_number": after, "at_most": limit})
        return [self._of(row) for row in rows]

    def telling(self, tenant: TenantId, query_numbers: Sequence[int], reasons: Sequence[str]) -> list[LoopRecord]:
        """See `LoopRepository`."""
        asked = {"queries": query_numbers, "its_tenant": tenant, "its_reasons": reasons}
        return [self._of(row) for row in self._connection.execute(_telling(self._sees_all), asked)]

    def rejected(
        self, tenant: TenantId, map_id: str, reasons: Sequence[str], *, after: int, limit: int
    ) -> list[LoopEnds]:
        """See `LoopRepository`."""
        asked = of_tenant(tenant, {"map_id": map_id, "state": LoopState.REJECTED.value, "manual": False})
        further = {"its_reasons": reasons, "after_number": after, "at_most": limit}
        rows = self._connection.execute(_rejected(self._sees_all, tuple(asked)), {**asked, **further})
        return [LoopEnds(*row) for row in rows]

    def reasons(self, tenant: TenantId, numbers: Sequence[int]) -> dict[str | None, int]:
        """See `LoopRepository`."""
        rows = self._connection.execute(_reasons(), {"numbers": numbers, "its_tenant": tenant})
        return {row.reason: row.loops for row in rows}


@cache
def _accepted(rows: Select[Any], *, limited: bool) -> Select[Any]:
    """The accepted ones of loops with a `seq` above `after_seq`, by it; `at_most` so many of them where `limited`."""
    seq = tables.loops.c.seq
    # The condition of the partial index, word for word.
    accepted = rows.where(text(tables.ACCEPTED), seq > bindparam("after_seq")).order_by(seq)
    return accepted.limit(bindparam("at_most")) if limited else accepted


@cache
def _measured(sees_all: bool, given: tuple[str, ...]) -> Select[Any]:
    """The next `at_most` loops above `after_number`, with as much of their evidence as a pose graph reads."""
    loops = tables.loops.c
    columns = (type_coerce(one, MeasuredCovariance()) if one is loops.evidence else one for one in loops)
    its, after = matches(tables.loops, dict.fromkeys(given, "")), loops.number > bindparam("after_number")
    query = select(*columns).where(its, after, seen(tables.loops, sees_all))
    return query.order_by(loops.number).limit(bindparam("at_most"))


@cache
def _rejected(sees_all: bool, given: tuple[str, ...]) -> Select[Any]:
    """The columns of LoopEnds of the next `at_most` loops above `after_number` with one of `its_reasons`."""
    loops, reasons = tables.loops.c, BindParameter[Any]("its_reasons", expanding=True)
    columns = (loops[field.name] for field in dataclasses.fields(LoopEnds))
    its = and_(matches(tables.loops, dict.fromkeys(given, "")), loops.reason.in_(reasons))
    after = loops.number > bindparam("after_number", type_=BigInteger)
    query = select(*columns).where(its, after, seen(tables.loops, sees_all))
    return query.order_by(loops.number).limit(bindparam("at_most"))


@cache
def _reasons() -> Select[Any]:
    """How many loops of the `numbers` have each reason; the tenant as in `_telling`."""
    loops, numbers = tables.loops.c, BindParameter[Any]("numbers", expanding=True)
    of_numbers = or_(loops.query_number.in_(numbers), loops.match_number.in_(numbers))
    where = and_(of_numbers, loops.tenant.concat("") == bindparam("its_tenant"))
    return select(loops.reason, func.count().label("loops")).where(where).group_by(loops.reason)


@cache
def _telling(sees_all: bool) -> Select[Any]:
    """Accepted loops of the `queries`, and those that are not accepted for one of `its_reasons`.

    The tenant is made an expression, which no index holds: else the engine looks through all loops of the tenant.
    """
    loops, queries = tables.loops.c, BindParameter[Any]("queries", expanding=True)
    reasons = BindParameter[Any]("its_reasons", expanding=True)
    of_tenant, accepted = loops.tenant.concat("") == bindparam("its_tenant"), loops.state == LoopState.ACCEPTED.value
    where = and_(loops.query_number.in_(queries), of_tenant, or_(accepted, loops.reason.in_(reasons)))
    return select(tables.loops).where(where, seen(tables.loops, sees_all)).order_by(loops.query_number, loops.number)

"""API keys and the audit log in an SQL database."""

from __future__ import annotations

import dataclasses

from sqlalchemy import Connection, insert, literal_column, select, update
from sqlalchemy.exc import IntegrityError

from revisit.service.domain.errors import AlreadyExists, NotFound
from revisit.service.engines.sql.access_tables import api_keys, audit_log
from revisit.service.engines.sql.engine import DatabaseEngine
from revisit.service.ports.access import AuditRecord, KeyRecord


class SqlKeyRing:
    """`access_ports.KeyRing`."""

    def __init__(self, connection: Connection) -> None:
        """All statements go through `connection`."""
        self._connection = connection

    def add(self, record: KeyRecord) -> KeyRecord:
        """See `access_ports.KeyRing`."""
        values = dataclasses.asdict(record)
        values.pop("number")
        try:
            statement = insert(api_keys).values(values).returning(api_keys.c.number)
            return dataclasses.replace(record, number=int(self._connection.execute(statement).scalar_one()))
        except IntegrityError as error:
            raise AlreadyExists from error

    def get(self, key_id: str, *, hold: bool = False) -> KeyRecord | None:
        """See `access_ports.KeyRing`."""
        query = select(api_keys).where(api_keys.c.key_id == key_id)
        row = self._connection.execute(query.with_for_update() if hold else query).one_or_none()
        return None if row is None else KeyRecord(**row._mapping)

    def all(self) -> list[KeyRecord]:
        """See `access_ports.KeyRing`."""
        rows = self._connection.execute(select(api_keys).order_by(api_keys.c.number))
        return [KeyRecord(**row._mapping) for row in rows]

    def replace(self, record: KeyRecord) -> None:
        """See `access_ports.KeyRing`."""
        values = dataclasses.asdict(record)
        statement = update(api_keys).where(api_keys.c.number == values.pop("number")).values(values)
        if self._connection.execute(statement).rowcount != 1:
            raise NotFound

    def is_empty(self) -> bool:
        """See `access_ports.KeyRing`."""
        return self._connection.execute(select(literal_column("1")).select_from(api_keys).limit(1)).first() is None


class SqlAuditTrail:
    """`access_ports.AuditTrail`."""

    def __init__(self, connection: Connection, engine: DatabaseEngine) -> None:
        """All statements go through `connection`, a connection of `engine`."""
        self._connection = connection
        self._engine = engine

    def append(self, record: AuditRecord) -> None:
        """See `access_ports.AuditTrail`."""
        try:
            self._connection.execute(insert(audit_log).values(dataclasses.asdict(record)))
        except IntegrityError as error:
            raise AlreadyExists from error

    def last(self) -> AuditRecord | None:
        """See `access_ports.AuditTrail`."""
        self._engine.number_in_commit_order(self._connection, audit_log)
        row = self._connection.execute(select(audit_log).order_by(audit_log.c.number.desc()).limit(1)).first()
        return None if row is None else AuditRecord(**row._mapping)

    def since(self, number: int, limit: int) -> list[AuditRecord]:
        """See `access_ports.AuditTrail`."""
        query = select(audit_log).where(audit_log.c.number > number).order_by(audit_log.c.number).limit(limit)
        return [AuditRecord(**row._mapping) for row in self._connection.execute(query)]

    def highest(self) -> int:
        """See `access_ports.AuditTrail`."""
        return self._engine.last_number(self._connection, audit_log)

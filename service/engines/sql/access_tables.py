"""The tables of access control: API keys and the audit log."""

from __future__ import annotations

from sqlalchemy import BigInteger, Column, String, Table, UniqueConstraint

from revisit.service.engines.sql.packed_columns import JsonTuple, StoredJson
from revisit.service.engines.sql.tables import metadata

api_keys = Table(
    "api_keys",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=True),
    Column("tenant", String(64), nullable=False),
    Column("key_id", String(64), nullable=False),
    Column("label", String(256), nullable=False),
    Column("scopes", JsonTuple(), nullable=False),
    Column("secret_sha256", String(64), nullable=False),
    Column("created_at_ns", BigInteger, nullable=False),
    Column("expires_at_ns", BigInteger, nullable=True),
    Column("revoked_at_ns", BigInteger, nullable=True),
    Column("successor_id", String(64), nullable=True),
    UniqueConstraint("key_id"),
)

# Triggers of the migration refuse every UPDATE and DELETE.
audit_log = Table(
    "audit_log",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=True),
    Column("at_ns", BigInteger, nullable=False),
    Column("tenant", String(64), nullable=False),
    Column("actor", String(256), nullable=False),
    Column("action", String(32), nullable=False),
    Column("subject", String(256), nullable=False),
    Column("detail", StoredJson(), nullable=False),
    Column("previous_hash", String(64), nullable=False),
    Column("hash", String(64), nullable=False),
)

"""Scopes: the rights of a credential."""

from __future__ import annotations

from revisit.core.string_enum import StrEnum


class Scope(StrEnum):
    """A right of a credential. None includes another."""

    INGEST = "ingest"
    QUERY = "query"
    ADMIN = "admin"


INGEST = frozenset({Scope.INGEST})
QUERY = frozenset({Scope.QUERY})
ADMIN = frozenset({Scope.ADMIN})
READ = INGEST | QUERY
"""Reading takes either."""

"""Scopes: the rights of a credential."""

from __future__ import annotations

from enum import Enum


class Scope(str, Enum):  # noqa: UP042  # Python 3.10, where the client runs, has no StrEnum
    """A right of a credential. None includes another."""

    INGEST = "ingest"
    QUERY = "query"
    ADMIN = "admin"

    __str__ = str.__str__


INGEST = frozenset({Scope.INGEST})
QUERY = frozenset({Scope.QUERY})
ADMIN = frozenset({Scope.ADMIN})
READ = INGEST | QUERY
"""Reading takes either."""

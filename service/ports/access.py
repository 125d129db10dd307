"""Ports of access control: keys, the audit log, tokens. tests/contract runs every implementation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from revisit.service.domain.identity import TenantId


@dataclass(frozen=True)
class KeyRecord:
    """An API key: the SHA-256 of its secret, never the secret. Times in nanoseconds since 1970, None for never."""

    tenant: TenantId
    key_id: str
    label: str
    scopes: tuple[str, ...]
    secret_sha256: str
    created_at_ns: int
    expires_at_ns: int | None
    revoked_at_ns: int | None
    successor_id: str | None = None
    number: int = 0


@dataclass(frozen=True)
class AuditRecord:
    """A row of the audit log; see `audit.row_hash`. `tenant` is empty where nobody was recognised."""

    number: int
    at_ns: int
    tenant: str
    actor: str
    action: str
    subject: str
    detail: dict[str, Any]
    previous_hash: str
    hash: str


class KeyRing(Protocol):
    """API keys of all tenants. Keys are never deleted: a revoked one stays and says so."""

    def add(self, record: KeyRecord) -> KeyRecord:
        """Store a new key. Raises AlreadyExists where its id is taken."""
        ...

    def get(self, key_id: str, *, hold: bool = False) -> KeyRecord | None:
        """The key with this id, or None. `hold`: until this transaction ends nobody else changes it."""
        ...

    def all(self) -> list[KeyRecord]:
        """Every key ever created, oldest first."""
        ...

    def replace(self, record: KeyRecord) -> None:
        """Overwrite the key of this number. Raises NotFound where there is none."""
        ...

    def is_empty(self) -> bool:
        """Whether no key was ever created."""
        ...


class AuditTrail(Protocol):
    """The rows of the audit log. There is no way to change or delete one."""

    def append(self, record: AuditRecord) -> None:
        """Add a row with the number it names. Raises AlreadyExists where that is taken."""
        ...

    def last(self) -> AuditRecord | None:
        """The row with the highest number; until this transaction ends nobody else appends one."""
        ...

    def since(self, number: int, limit: int) -> list[AuditRecord]:
        """At most `limit` rows above `number`, in order."""
        ...

    def highest(self) -> int:
        """The highest number ever given out, whether or not its row is still there."""
        ...


@dataclass(frozen=True)
class TokenClaims:
    """The claims of a verified token: tenant, name of the client, scopes."""

    tenant: TenantId
    subject: str
    scopes: frozenset[str]


class TokenVerifier(Protocol):
    """Checks tokens that someone else issued."""

    def verify(self, token: str, now_s: float) -> TokenClaims:
        """The claims of the token. May wait for the issuer. Raises Unauthenticated."""
        ...

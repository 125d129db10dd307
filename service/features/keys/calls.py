"""API keys: `rv_<id>_<secret>`. The secret is 256 random bits, so its SHA-256 is all that needs to be kept."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import string
from collections.abc import Sequence
from dataclasses import dataclass, replace

from revisit.api.scopes import Scope
from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.domain.callers import Caller, current_actor
from revisit.service.domain.errors import NotFound, RevokedKey, Unauthenticated
from revisit.service.domain.identity import TenantId, validated_id, validated_label
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry
from revisit.service.ports.access import KeyRecord
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

NS = 1_000_000_000
SECRET_BYTES = 32
SECRET_CHARACTERS = 43
"""62^43 > 2^256."""

_BASE62 = string.digits + string.ascii_uppercase + string.ascii_lowercase
_ID_LETTERS = string.ascii_lowercase + string.digits
_ID_CHARACTERS = 12
_KEY = re.compile(rf"rv_([a-z0-9]{{{_ID_CHARACTERS}}})_([A-Za-z0-9]{{{SECRET_CHARACTERS}}})", re.ASCII)

# Compared against where there is no such key, so that the time taken does not tell ids that exist.
_NO_SECRET = hashlib.sha256(secrets.token_bytes(SECRET_BYTES)).hexdigest()


@dataclass(frozen=True)
class ShownKey:
    """The parts of a client's key."""

    key_id: str
    secret: str

    @property
    def secret_sha256(self) -> str:
        """The stored hash of the secret."""
        return hashlib.sha256(self.secret.encode()).hexdigest()


@dataclass(frozen=True)
class NewKey:
    """A key as it is given out, once: `text` cannot be had again."""

    record: KeyRecord
    text: str


@dataclass(frozen=True)
class CreateKey:
    """A new key; `lifetime_s` None for one that does not expire."""

    tenant: str
    scopes: Sequence[str]
    label: str = ""
    lifetime_s: float | None = None


def parse_key(text: str) -> ShownKey | None:
    """The parts of an API key, or None where the text is none."""
    match = _KEY.fullmatch(text)
    return None if match is None else ShownKey(match[1], match[2])


def caller_of_key(record: KeyRecord | None, shown: ShownKey, now_ns: int) -> Caller:
    """The owner of a key. Raises Unauthenticated for a wrong secret, RevokedKey for one that no longer counts."""
    stored = _NO_SECRET if record is None else record.secret_sha256
    if not hmac.compare_digest(stored, shown.secret_sha256) or record is None:
        raise Unauthenticated
    # Only the holder of the secret learns why it no longer counts.
    if record.revoked_at_ns is not None:
        raise RevokedKey(f"the key {record.key_id} was revoked")
    if record.expires_at_ns is not None and record.expires_at_ns <= now_ns:
        raise RevokedKey(f"the key {record.key_id} has expired")
    return Caller(record.tenant, f"key {record.key_id}", frozenset(Scope(scope) for scope in record.scopes))


def is_live(record: KeyRecord, now_ns: int) -> bool:
    """Whether the key opens anything now."""
    return record.revoked_at_ns is None and (record.expires_at_ns is None or record.expires_at_ns > now_ns)


class ApiKeys:
    """Create, list, rotate and revoke keys; each change is a row of the audit log in the same transaction."""

    def __init__(self, storage: Storage, clock: Clock) -> None:
        """Keys are kept in `storage`."""
        self._storage = storage
        self._clock = clock

    async def create(self, command: CreateKey) -> NewKey:
        """A new key. Raises BadField."""
        made = self._made(command)
        entry = audit.noted(made.record.tenant, "key_created", f"keys/{made.record.key_id}", scopes=made.record.scopes)

        def add(uow: UnitOfWork) -> KeyRecord:
            audit.append(uow, made.record.created_at_ns, entry)
            return uow.keys.add(made.record)

        return replace(made, record=await self._storage.write(add))

    async def all(self) -> list[KeyRecord]:
        """Every key ever created, oldest first."""
        return await self._storage.read(lambda uow: uow.keys.all())

    async def any_live(self) -> bool:
        """Whether some key opens something now."""
        now_ns = self._clock.wall_ns()
        return any(is_live(record, now_ns) for record in await self.all())

    async def revoke(self, key_id: str) -> KeyRecord:
        """The key opens nothing from now on; again: no effect. Raises NotFound."""
        now_ns, actor = self._clock.wall_ns(), current_actor()

        def change(uow: UnitOfWork) -> KeyRecord:
            known = _require(uow, key_id)
            if known.revoked_at_ns is not None:
                return known
            revoked = replace(known, revoked_at_ns=now_ns)
            uow.keys.replace(revoked)
            audit.append(uow, now_ns, AuditEntry(known.tenant, actor, "key_revoked", f"keys/{key_id}", {}))
            return revoked

        return await self._storage.write(change)

    async def rotate(self, key_id: str, grace_s: float) -> NewKey:
        """A successor with the same rights and lifetime; the old key goes on for `grace_s` at most.

        Raises NotFound; BadField where the key is no longer live or has a successor already.
        """
        now_ns, actor = self._clock.wall_ns(), current_actor()

        def change(uow: UnitOfWork) -> NewKey:
            known = _require(uow, key_id)
            if not is_live(known, now_ns) or known.successor_id is not None:
                raise BadField(f"key {key_id} is not live or was rotated before", field="key_id")
            lifetime_ns = None if known.expires_at_ns is None else known.expires_at_ns - known.created_at_ns
            lifetime_s = None if lifetime_ns is None else lifetime_ns / NS
            made = self._made(CreateKey(known.tenant, known.scopes, known.label, lifetime_s))
            ends_ns = now_ns + int(grace_s * NS)
            ends_ns = ends_ns if known.expires_at_ns is None else min(ends_ns, known.expires_at_ns)
            uow.keys.replace(replace(known, expires_at_ns=ends_ns, successor_id=made.record.key_id))
            detail = {"successor": made.record.key_id}
            audit.append(uow, now_ns, AuditEntry(known.tenant, actor, "key_rotated", f"keys/{key_id}", detail))
            return replace(made, record=uow.keys.add(made.record))

        return await self._storage.write(change)

    def _made(self, command: CreateKey) -> NewKey:
        validated_id(command.tenant, "tenant")
        validated_label(command.label, "label")
        unknown = set(command.scopes) - set(Scope)
        if unknown or not command.scopes:
            raise BadField(f"scopes are one or more of {', '.join(Scope)}", field="scopes")
        if command.lifetime_s is not None:
            limits.KEY_LIFETIME_S.validated(command.lifetime_s, "lifetime_s")
        shown = _random_key()
        now_ns = self._clock.wall_ns()
        record = KeyRecord(
            tenant=TenantId(command.tenant),
            key_id=shown.key_id,
            label=command.label,
            scopes=tuple(scope.value for scope in Scope if scope in command.scopes),
            secret_sha256=shown.secret_sha256,
            created_at_ns=now_ns,
            expires_at_ns=None if command.lifetime_s is None else now_ns + int(command.lifetime_s * NS),
            revoked_at_ns=None,
        )
        return NewKey(record, f"rv_{shown.key_id}_{shown.secret}")


def _random_key() -> ShownKey:
    number = secrets.randbits(8 * SECRET_BYTES)
    digits = []
    for _ in range(SECRET_CHARACTERS):
        number, digit = divmod(number, len(_BASE62))
        digits.append(_BASE62[digit])
    return ShownKey("".join(secrets.choice(_ID_LETTERS) for _ in range(_ID_CHARACTERS)), "".join(digits))


def _require(uow: UnitOfWork, key_id: str) -> KeyRecord:
    known = uow.keys.get(key_id, hold=True)
    if known is None:
        raise NotFound(f"there is no key {key_id!r}"[:100])
    return known

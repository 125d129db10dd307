"""Authentication: a credential becomes a caller, or is refused, before the request is read."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass, field

import structlog

from revisit.api.scopes import Scope
from revisit.core.errors import RevisitError
from revisit.service.capacity.call_pace import CallPace
from revisit.service.domain.callers import (
    ANYONE,
    Caller,
    current_actor,
    current_tenant,
    current_tenant_or_none,
)
from revisit.service.domain.errors import PermissionDenied, TooManyFailures, Unauthenticated
from revisit.service.domain.identity import TenantId
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import AuditEntry, AuditLog
from revisit.service.features.keys.calls import caller_of_key, parse_key
from revisit.service.features.keys.failed_attempts import FailedAttempts
from revisit.service.features.keys.known_keys import KnownKeys
from revisit.service.ports.access import TokenVerifier
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.redaction import redacted

MAX_CREDENTIAL_CHARACTERS = 8192
STREAM_RECHECK_S = 1.0
"""How often the credential of an open stream is verified again."""

STREAM_ENDS_WITHIN_S = 3.0
"""The documented bound: an open stream ends so soon after its credential has lost its right. More than one look."""

_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Credential:
    """A client's credentials: a bearer token; the names in its verified certificate; and the address it calls from."""

    bearer: str | None = None
    certificate_names: tuple[str, ...] = ()
    address: str = ""


@dataclass(frozen=True)
class CertificateGrant:
    """Tenant and scopes of a name in a client certificate."""

    tenant: TenantId
    scopes: frozenset[Scope]


@dataclass(frozen=True)
class AccessRules:
    """How this installation recognises callers.

    Unless `required`, anyone is admitted as long as no key was ever created, no tokens are taken and no certificates
    are mapped. A credential that is shown is verified in any case.
    """

    required: bool = False
    tokens: TokenVerifier | None = None
    certificates: Mapping[str, CertificateGrant] = field(default_factory=dict)


class Access:
    """Authenticates and authorises callers, and notes refusals in the audit log."""

    def __init__(self, storage: Storage, audit_log: AuditLog, clock: Clock, rules: AccessRules, pace: CallPace) -> None:
        """Keys are looked up in `storage`; `pace` holds back clients that begin too many calls."""
        self._audit = audit_log
        self._clock = clock
        self._rules = rules
        self._pace = pace
        self._failed = FailedAttempts(lambda: clock.monotonic_ms() / 1000)
        self._keys = KnownKeys(storage)

    async def admit_call(
        self, credential: Credential, scopes: frozenset[Scope], call: str, path: str | None = None
    ) -> Caller:
        """As `admit`, for a call that begins: it waits where its caller begins too many. Raises also RateLimited."""
        try:
            caller = await self.admit(credential, scopes, call, path)
        except (Unauthenticated, PermissionDenied, TooManyFailures):
            await self.delay_refusal(credential.address)
            raise
        await self._pace.turn(caller.tenant, caller.name)
        return caller

    async def admit_public(self, address: str) -> None:
        """Return when a call that needs no credential may begin. Raises RateLimited where too many wait."""
        await self._pace.public(address)

    def note_unread(self, unread_bytes: int) -> None:
        """The body of this call was refused before it was read: further calls of its caller wait longer for it."""
        tenant = current_tenant_or_none()
        if tenant is not None:
            self._pace.note_unread(tenant, current_actor(), unread_bytes)

    def note_json(self, json_bytes: int) -> None:
        """So much JSON of this call is read: further calls of its caller wait longer for it."""
        self._pace.note_json(current_tenant(), current_actor(), json_bytes)

    async def delay_refusal(self, address: str) -> None:
        """Wait before an unauthenticated call is refused, if those of its address are refused too often."""
        await self._pace.refusal(address)

    async def admit(
        self, credential: Credential, scopes: frozenset[Scope], call: str, path: str | None = None
    ) -> Caller:
        """The caller, with one of `scopes`; for the audit log, `call` is the route or RPC.

        `path` is the client's own text. It is noted of known callers: others may have written anything, their key for
        example.

        Raises Unauthenticated, PermissionDenied, TooManyFailures; for administration, the errors of storing the row.
        """
        caller: Caller | None = None
        try:
            caller = await self.identify(credential)
            caller.require_any(scopes)
        except (Unauthenticated, PermissionDenied) as error:
            await self._note_refusal(error, caller, credential, call if caller is None else path or call)
            raise
        if scopes == {Scope.ADMIN}:
            await self._audit.note(AuditEntry(caller.tenant, caller.name, "admin_call", _subject(path or call), {}))
        return caller

    async def identify(self, credential: Credential) -> Caller:
        """The caller of a credential. Raises Unauthenticated."""
        if credential.bearer is not None:
            return await self._of_bearer(credential.bearer)
        for name in credential.certificate_names:
            if name in self._rules.certificates:
                grant = self._rules.certificates[name]
                return Caller(grant.tenant, audit.printable(f"certificate {name}"), grant.scopes)
        if await self.is_open():
            return ANYONE
        raise Unauthenticated("send an API key: `Authorization: Bearer rv_...`")

    async def is_open(self) -> bool:
        """Whether anyone is admitted without a credential."""
        rules = self._rules
        if rules.required or rules.tokens is not None or rules.certificates:
            return False
        return await self._keys.is_empty()

    async def _of_bearer(self, text: str) -> Caller:
        shown = parse_key(text)
        if shown is not None:
            return caller_of_key(await self._keys.get(shown.key_id), shown, self._clock.wall_ns())
        if self._rules.tokens is None or len(text) > MAX_CREDENTIAL_CHARACTERS:
            raise Unauthenticated
        now_s = self._clock.wall_ns() / 1e9
        claims = await asyncio.to_thread(self._rules.tokens.verify, text, now_s)
        scopes = frozenset(scope for scope in Scope if scope.value in claims.scopes)
        return Caller(claims.tenant, audit.printable(f"token {claims.subject}"), scopes)

    async def _note_refusal(
        self, error: RevisitError, caller: Caller | None, credential: Credential, call: str
    ) -> None:
        """Write a refusal down while there are not too many; raises TooManyFailures beyond that."""
        wait_s = self._failed.count(credential.address)
        if wait_s > 0.0:
            if caller is None:
                raise TooManyFailures(retry_after_s=wait_s) from error
            return
        tenant, actor = (caller.tenant, caller.name) if caller is not None else ("", "unknown")
        detail = {"address": credential.address, "reason": error.message}
        if over_budget := self._failed.take_over_budget():
            detail["over_budget_before"] = str(over_budget)
        try:
            await self._audit.note(AuditEntry(tenant, actor, "refused", _subject(call), detail))
        except RevisitError as failure:
            # Refusing comes first: a full disk must not change the answer.
            _log.error("refusal_not_in_audit_log", reason=failure.code.value)


def _subject(asked: str) -> str:
    """The request's path in the audit log."""
    return audit.printable(redacted(asked))

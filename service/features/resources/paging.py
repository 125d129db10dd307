"""Lists in pages: a size, an opaque token, and the token of the next page.

Rows are listed by their numbers. A list therefore holds all that was stored when its first page was asked for. Of the
rows that are stored while its pages are read some may be missing: PostgreSQL gives the numbers before the commits.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Generic, Protocol, TypeVar

from revisit.core.errors import BadField
from revisit.service.capacity.in_flight import InFlight, Turns
from revisit.service.capacity.limits import LISTS_AT_A_TIME, ROW_POINTS
from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId
from revisit.service.ports.repositories import RowReader
from revisit.service.ports.storage import Storage, require_map
from revisit.service.ports.transactions import UnitOfWork

T = TypeVar("T")
N = TypeVar("N", bound="Numbered")

_HALF_BYTES = 8


@dataclass(frozen=True)
class PageRequest:
    """Ask for at most `size` items (1 to 500) after the page that gave `token` ("" for the first page)."""

    size: int = 50
    token: str = ""

    def __post_init__(self) -> None:
        """Raises BadField for a size out of bounds."""
        limits.PAGE_SIZE.validated(self.size, "page_size")


@dataclass(frozen=True)
class Page(Generic[T]):
    """Items in the order they were created; `next_token` is "" on the last page."""

    items: tuple[T, ...]
    next_token: str


class Numbered(Protocol):
    """Anything listed by number."""

    @property
    def number(self) -> int:
        """Its place in the order of creation."""
        ...


class PageTokens:
    """Tokens that tell their reader nothing and are good for one tenant only.

    A row's number counts the rows of all tenants, so it is encrypted: with a stream made of its own keyed hash, as SIV
    modes do (RFC 5297). The hash comes first in the token and proves it.
    """

    def __init__(self, secret: bytes) -> None:
        """`secret` is known to this installation alone. With another one, tokens given out before are refused."""
        self._secret = secret

    def after(self, tenant: TenantId, number: int) -> str:
        """The token of the page after the row of that number."""
        plain = number.to_bytes(_HALF_BYTES, "big")
        proof = self._hash(b"proof", tenant, plain)
        return base64.urlsafe_b64encode(proof + _xor(plain, self._hash(b"stream", tenant, proof))).decode()

    def number_in(self, tenant: TenantId, token: str) -> int:
        """The number of the last row already seen, 0 without a token. Raises BadField for a foreign token."""
        if not token:
            return 0
        try:
            content = base64.b64decode(token.encode("ascii"), altchars=b"-_", validate=True)
        except (UnicodeError, binascii.Error) as error:
            raise _foreign() from error
        proof, hidden = content[:_HALF_BYTES], content[_HALF_BYTES:]
        plain = _xor(hidden, self._hash(b"stream", tenant, proof))
        if len(content) != 2 * _HALF_BYTES or not hmac.compare_digest(proof, self._hash(b"proof", tenant, plain)):
            raise _foreign()
        return int.from_bytes(plain, "big")

    def _hash(self, purpose: bytes, tenant: TenantId, data: bytes) -> bytes:
        message = b"\0".join((b"page token", purpose, tenant.encode(), data))
        return hmac.digest(self._secret, message, hashlib.sha256)[:_HALF_BYTES]


def as_it_is(_uow: UnitOfWork, row: T) -> T:
    """The view of a row that clients see as it is."""
    return row


def rows_of_map(
    kind: Callable[[UnitOfWork], RowReader[N]], tenant: TenantId, map_id: str
) -> Callable[[UnitOfWork, int, int], Sequence[N]]:
    """The `find` of a page of the rows of one kind that a map has. It raises NotFound where there is no map."""

    def find(uow: UnitOfWork, after: int, limit: int) -> Sequence[N]:
        require_map(uow, tenant, map_id)
        return kind(uow).find(tenant, after=after, limit=limit, map_id=map_id)

    return find


class Lists:
    """Reads lists, page by page. They cost quota by the row, and tenants take turns: a long page keeps a core busy."""

    def __init__(self, storage: Storage, in_flight: InFlight, tokens: PageTokens) -> None:
        """Rows are charged to the rate limits of `in_flight`."""
        self._storage = storage
        self._in_flight = in_flight
        self._tokens = tokens
        self._turns = Turns(LISTS_AT_A_TIME, of_tenant=1)

    async def page(
        self,
        tenant: TenantId,
        page: PageRequest,
        find: Callable[[UnitOfWork, int, int], Sequence[N]],
        view: Callable[[UnitOfWork, N], T],
    ) -> Page[T]:
        """The views of a page of rows; `find` gets the number after which they begin, and how many it may find at most.

        Raises BadField for a token of somebody else, RateLimited, and the errors of `find` and `view`.
        """
        after = self._tokens.number_in(tenant, page.token)
        async with self._turns.of(tenant):
            # After its turn has come, when the calls before it are charged.
            self._in_flight.check_rate(tenant)
            read = partial(self._read, tenant=tenant, after=after, size=page.size, find=find, view=view)
            found = await self._storage.read(read)
            self._in_flight.charge_call(tenant, ROW_POINTS * len(found.items))
            return found

    def _read(
        self,
        uow: UnitOfWork,
        tenant: TenantId,
        after: int,
        size: int,
        find: Callable[[UnitOfWork, int, int], Sequence[N]],
        view: Callable[[UnitOfWork, N], T],
    ) -> Page[T]:
        # One more than is shown tells whether there is a next page.
        records = find(uow, after, size + 1)
        shown = records[:size]
        token = self._tokens.after(tenant, shown[-1].number) if len(records) > size else ""
        return Page(tuple(view(uow, record) for record in shown), token)


def _xor(one: bytes, other: bytes) -> bytes:
    return bytes(first ^ second for first, second in zip(one, other, strict=False))


def _foreign() -> BadField:
    return BadField("page_token was not given out to you by this service", field="page_token")

"""Lists in pages: a size, an opaque token, and the token of the next page."""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from revisit.core.errors import BadField
from revisit.service.application.contract import limits

T = TypeVar("T")
N = TypeVar("N", bound="Numbered")


@dataclass(frozen=True)
class PageRequest:
    """Ask for at most `size` items (1 to 500) after the page that gave `token` ("" for the first page)."""

    size: int = 50
    token: str = ""

    def __post_init__(self) -> None:
        """Raises BadField for a size out of bounds."""
        limits.PAGE_SIZE.validated(self.size, "page_size")

    @property
    def after(self) -> int:
        """The number of the last item already seen, 0 for none. Raises BadField for a foreign token."""
        if not self.token:
            return 0
        try:
            text = base64.b64decode(self.token.encode("ascii"), altchars=b"-_", validate=True).decode("ascii")
        except (UnicodeError, binascii.Error) as error:
            raise BadField("page_token was not given out by this service", field="page_token") from error
        if not re.fullmatch(r"after:[0-9]{1,18}", text, re.ASCII):
            raise BadField("page_token was not given out by this service", field="page_token")
        return int(text.removeprefix("after:"))


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


def page_of(records: Sequence[N], page: PageRequest, view: Callable[[N], T]) -> Page[T]:
    """A page of the views of `records`, of which one more than `page.size` was loaded where there is more."""
    shown = records[: page.size]
    more = len(records) > page.size
    return Page(tuple(view(record) for record in shown), _token_after(shown[-1].number) if more else "")


def _token_after(number: int) -> str:
    return base64.urlsafe_b64encode(f"after:{number}".encode()).decode()

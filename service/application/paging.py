"""Lists in pages: a size, an opaque token, and the token of the next page."""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass
from typing import Generic, TypeVar

from core.errors import BadField

T = TypeVar("T")

MAX_PAGE_SIZE = 500


@dataclass(frozen=True)
class PageRequest:
    """Ask for at most `size` items (1 to 500) after the page that gave `token` ("" for the first page)."""

    size: int = 50
    token: str = ""

    def __post_init__(self) -> None:
        """Raises BadField for a size out of bounds."""
        if not 1 <= self.size <= MAX_PAGE_SIZE:
            raise BadField(f"page_size must be in 1..{MAX_PAGE_SIZE}", field="page_size")

    @property
    def after(self) -> int:
        """The number of the last item already seen, 0 for none. Raises BadField for a foreign token."""
        if not self.token:
            return 0
        try:
            text = base64.urlsafe_b64decode(self.token.encode("ascii")).decode("ascii")
            return int(text.removeprefix("after:"))
        except (UnicodeError, binascii.Error, ValueError) as error:
            raise BadField("page_token was not given out by this service", field="page_token") from error


@dataclass(frozen=True)
class Page(Generic[T]):
    """Items in the order they were created; `next_token` is "" on the last page."""

    items: tuple[T, ...]
    next_token: str


def token_after(number: int) -> str:
    """The opaque token of the page that begins after item `number`."""
    return base64.urlsafe_b64encode(f"after:{number}".encode()).decode()

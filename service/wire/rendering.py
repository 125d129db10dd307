"""Making long answers: beside the event loop, which otherwise would serve nobody meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from google.protobuf.message import Message

from revisit.service.application.catalogue.paging import Page
from revisit.service.wire.answers import Fields, of_page

T = TypeVar("T")
M = TypeVar("M", bound=Message)

FEW = 50
"""So many items take about a millisecond."""

# One thread: more would only wait for each other, and the event loop for all of them.
_BESIDE = ThreadPoolExecutor(1, "render")


async def rendered(page: Page[Any], make: Callable[[], T]) -> T:
    """What `make` makes of a page."""
    if len(page.items) <= FEW:
        return make()
    return await asyncio.get_running_loop().run_in_executor(_BESIDE, make)


async def page_message(message: type[M], collection: str, page: Page[T], of: Callable[[T], Fields]) -> M:
    """The List...Response that holds `collection`."""
    return await rendered(page, lambda: message(**of_page(collection, page, of)))

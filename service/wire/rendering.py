"""Making answers: long ones beside the event loop, which otherwise would serve nobody meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from revisit.service.features.resources.paging import Page
from revisit.service.wire.fields import Fields

T = TypeVar("T")

FEW = 50
"""So many items take about a millisecond."""

# One thread: more would only wait for each other, and the event loop for all of them.
_BESIDE = ThreadPoolExecutor(1, "render")


@dataclass(frozen=True)
class Listed:
    """The answer of a List call: a page, the field that holds it, and the fields of one item."""

    collection: str
    page: Page[Any]
    of: Callable[[Any], Fields]

    def fields(self) -> Fields:
        """The fields of the List...Response."""
        return {self.collection: [self.of(item) for item in self.page.items], "next_page_token": self.page.next_token}


Answer: TypeAlias = Fields | Listed


async def rendered(answer: Answer, make: Callable[[Fields], T]) -> T:
    """The form that `make` makes of an answer."""
    if not isinstance(answer, Listed):
        return make(answer)
    if len(answer.page.items) <= FEW:
        return make(answer.fields())
    return await asyncio.get_running_loop().run_in_executor(_BESIDE, lambda: make(answer.fields()))

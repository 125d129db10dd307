"""The processes of an installation that others have to know of."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class ProcessRole(StrEnum):
    """The work of a process."""

    GATEWAY = "gateway"
    SEARCH = "search"


@dataclass(frozen=True)
class LivingProcess:
    """A gateway or search process.

    Of a search process also: the address where it is asked, whether its maps are loaded, and those that keep it too
    busy, by number.
    """

    process_id: str
    role: ProcessRole
    address: str = ""
    ready: bool = False
    busy: frozenset[int] = frozenset()

"""`enum.StrEnum`, which Python 3.10 does not have: the client runs there."""

from __future__ import annotations

from enum import Enum

try:
    from enum import StrEnum as StrEnum
except ImportError:

    class StrEnum(str, Enum):  # type: ignore[no-redef]  # noqa: UP042
        """Strings with names; written, a member is its value."""

        __str__ = str.__str__
        __format__ = str.__format__  # type: ignore[assignment]

"""PostgreSQL's errors, given their meaning: no room, damaged, another process in the way, or uncertain."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DataError, DBAPIError, IntegrityError
from sqlalchemy.exc import TimeoutError as PoolExhausted

from revisit.core.errors import DataLoss
from revisit.service.domain.errors import NotFound, StorageFull, StorageUncertain

FULL = ("53100",)
DAMAGED = ("XX001", "XX002")
READ_ONLY = ("25006",)
"""A standby, or a server that was told to take no data."""

LOCKED = ("55P03",)
"""A lock was not given within `lock_timeout`."""

IN_THE_WAY = ("40001", "40P01", *LOCKED)
"""Another transaction changed the rows, waits for ours, or holds them for too long."""


@contextmanager
def translated() -> Iterator[None]:
    """Raises StorageFull, DataLoss or StorageUncertain for an error of the database in the block."""
    try:
        yield
    except DBAPIError as error:
        raise _translation(error) from error
    except PoolExhausted as error:
        raise StorageUncertain("all connections to the database are in use; nothing was stored") from error


def is_disturbed(error: BaseException) -> bool:
    """Whether work failed by what another process was doing, or has just done: run again it may end otherwise.

    A row that is refused for its key, or its parent, may have lost a race: the next run sees who won it.
    """
    if isinstance(error, IntegrityError) or isinstance(error.__cause__, IntegrityError):
        return True
    return isinstance(error, DBAPIError) and sqlstate(error) in IN_THE_WAY


def sqlstate(error: DBAPIError) -> str:
    """The five characters of the SQL standard; "" where the server said nothing."""
    return str(getattr(error.orig, "sqlstate", None) or "")


def _translation(error: DBAPIError) -> Exception:
    state = sqlstate(error)
    if isinstance(error, DataError) and not state:
        return NotFound("no name has such a character")  # NUL, which text of PostgreSQL cannot hold, nor that of a name
    if state in FULL:
        return StorageFull()
    if state in DAMAGED:
        return DataLoss(f"the database is damaged: {error.orig}")
    if state in READ_ONLY:
        return StorageUncertain("the database takes no data at the moment; nothing was stored")
    if state in LOCKED:
        return StorageUncertain("another process holds the rows; nothing was stored")
    reason = f"the database failed: {str(error.orig).strip()}"[:300]
    return StorageUncertain("the database failed; repeat this with the same id", reason=reason)

"""The engine that keeps the state: SQLite in the data folder, or the PostgreSQL that REVISIT_DATABASE_URL names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.local.files.disk import FailStop
from revisit.service.ports.blobs import StoredBlob
from revisit.service.ports.transactions import Transactions

if TYPE_CHECKING:
    from sqlalchemy import Engine


class State(Protocol):
    """The database of an installation, before and while it is open."""

    @property
    def name(self) -> str:
        """The database in messages: no password is in it."""
        ...

    @property
    def on_this_machine(self) -> bool:
        """Whether it is a file of the data folder, whose log the gateway folds back."""
        ...

    def broken(self) -> str:
        """The damage of a database that cannot be read; "" where there is none."""
        ...

    def is_made(self) -> bool:
        """Whether there is a schema that a worker can run on. Raises ForeignSchema, StorageUncertain."""
        ...

    def migrate(self, revision: str = "head") -> None:
        """Bring it to the schema of this version. Raises ForeignSchema, StorageUncertain."""
        ...

    def sole_gateway(self) -> AbstractContextManager[None]:
        """Held by a gateway while it serves. Raises HomeTaken where another one must not run beside it."""
        ...

    def transactions(
        self, *, gateway: bool, lease_ms: int, clock: SystemClock, fail_stop: FailStop, on_full: Callable[[], None]
    ) -> Transactions:
        """Open it."""
        ...

    def writer(self) -> AbstractContextManager[Engine]:
        """An engine of one connection beside all transactions, for a move; closed at the end."""
        ...

    def damaged_rows(self) -> list[str]:
        """Rows that are not what was written, as `table number`; none of a server, which tells at each reading."""
        ...

    def newest_clouds(self, count: int) -> list[StoredBlob]:
        """The clouds of the last scans and submaps, so many of each; none where there is no schema yet."""
        ...


def state_of(home: Path, database_url: str) -> State:
    """The state of an installation. Raises UnusableServer."""
    if not database_url:
        return SqliteState(home)
    return PostgresState(home, database_url)


class SqliteState:
    """`State` in a file of the data folder, which must be on this machine."""

    on_this_machine = True

    def __init__(self, home: Path) -> None:
        """Nothing is opened yet."""
        from revisit.service.engines.local.sqlite.connections import DATABASE

        self._home, self._database = home, home / DATABASE

    @property
    def name(self) -> str:
        """See `State`."""
        return str(self._database)

    def broken(self) -> str:
        """See `State`."""
        from revisit.service.engines.local.sqlite.connections import unreadable

        return unreadable(self._database)

    def is_made(self) -> bool:
        """See `State`."""
        from revisit.service.engines.local.sqlite.migration import current_revision

        return current_revision(self._database) is not None

    def migrate(self, revision: str = "head") -> None:
        """See `State`. Raises RemoteFileSystem."""
        from revisit.service.engines.local.sqlite.migration import migrate

        migrate(self._database, revision)

    def sole_gateway(self) -> AbstractContextManager[None]:
        """See `State`."""
        from revisit.service.engines.local.files.home_lock import sole_gateway

        return sole_gateway(self._home)

    def transactions(
        self, *, gateway: bool, lease_ms: int, clock: SystemClock, fail_stop: FailStop, on_full: Callable[[], None]
    ) -> Transactions:
        """See `State`. Raises RemoteFileSystem."""
        from revisit.service.engines.local.files.filesystem import require_local
        from revisit.service.engines.local.sqlite.transactions import SqliteTransactions

        require_local(self._home)
        return SqliteTransactions(
            self._database,
            checkpoints=gateway,
            lease_ms=lease_ms,
            clock=clock,
            fail_stop=fail_stop,
            on_full=on_full,
        )

    def writer(self) -> AbstractContextManager[Engine]:
        """See `State`."""
        from revisit.service.engines.local.sqlite.connections import writer_engine

        return _closed(writer_engine(self._database, checkpoints=True))

    def damaged_rows(self) -> list[str]:
        """See `State`. Raises sqlite3.Error where the damage keeps it from being read."""
        from revisit.service.engines.local.sqlite.connections import open_to_read
        from revisit.service.engines.local.sqlite.row_checksums import damaged_rows

        with closing(open_to_read(self._database)) as rows:
            return list(damaged_rows(rows))

    def newest_clouds(self, count: int) -> list[StoredBlob]:
        """See `State`."""
        from revisit.service.engines.local.sqlite.blob_rows import newest_clouds
        from revisit.service.engines.local.sqlite.connections import open_to_read

        with closing(open_to_read(self._database)) as rows:
            return newest_clouds(rows, count)


class PostgresState:
    """`State` in a PostgreSQL database, which any number of gateways and workers share."""

    on_this_machine = False

    def __init__(self, home: Path, database_url: str) -> None:
        """`home` keeps the blobs. Nothing is connected yet. Raises UnusableServer."""
        from revisit.service.engines.postgres.connections import server_url

        self._home, self._url = home, server_url(database_url)

    @property
    def name(self) -> str:
        """See `State`."""
        return self._url.render_as_string(hide_password=True)

    def broken(self) -> str:
        """See `State`: a server tells each statement by itself."""
        return ""

    def is_made(self) -> bool:
        """See `State`."""
        from revisit.service.engines.postgres.migration import current_revision, require_fitting

        if current_revision(self._url) is None:
            return False
        require_fitting(self._url)
        return True

    def migrate(self, revision: str = "head") -> None:
        """See `State`. Raises UnusableServer."""
        from revisit.service.engines.postgres.migration import migrate

        migrate(self._url, revision)

    def sole_gateway(self) -> AbstractContextManager[None]:
        """See `State`: gateways may run beside each other."""
        return nullcontext()

    def transactions(
        self, *, gateway: bool, lease_ms: int, clock: SystemClock, fail_stop: FailStop, on_full: Callable[[], None]
    ) -> Transactions:
        """See `State`."""
        from revisit.service.engines.postgres.transactions import PostgresTransactions

        self._home.mkdir(parents=True, exist_ok=True, mode=0o700)
        return PostgresTransactions(self._url, lease_ms=lease_ms, clock=clock)

    def writer(self) -> AbstractContextManager[Engine]:
        """See `State`."""
        from revisit.service.engines.postgres.connections import writer_engine

        return _closed(writer_engine(self._url))

    def damaged_rows(self) -> list[str]:
        """See `State`."""
        return []

    def newest_clouds(self, count: int) -> list[StoredBlob]:
        """See `State`."""
        from revisit.service.engines.postgres.examination import newest_clouds

        return newest_clouds(self._url, count)


@contextmanager
def _closed(engine: Engine) -> Iterator[Engine]:
    try:
        yield engine
    finally:
        engine.dispose()

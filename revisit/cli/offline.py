"""The use cases on a data folder, whether or not a service runs on it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from revisit.cli.output import refuse

if TYPE_CHECKING:
    from revisit.service.engines.stored_blobs import Bucket
    from revisit.service.use_cases import UseCases


def data_folder(home: Path | None) -> Path:
    """The folder that was named, else that of the settings. Raises typer.Exit where the state is not in it."""
    from revisit.service.settings_loading import load_settings

    settings = load_settings(home)
    if settings.database_url:
        raise refuse(
            "the state is in PostgreSQL (REVISIT_DATABASE_URL), which has tools of its own for this: pg_dump and "
            "pg_restore. Copy the blobs in REVISIT_HOME after the database"
        )
    return settings.home


def bucket_of(home: Path | None) -> Bucket | None:
    """The bucket of the blobs; None where they lie in the data folder."""
    from revisit.service.composition import bucket
    from revisit.service.settings_loading import load_settings

    settings = load_settings(home)
    return bucket(settings) if settings.blob_url else None


@contextmanager
def use_cases_on(home: Path | None) -> Iterator[UseCases]:
    """The use cases on the database, which is made where it is missing. Raises typer.Exit where it does not fit."""
    from revisit.service.composition import offline_use_cases
    from revisit.service.engines.schema import ForeignSchema, UnusableServer
    from revisit.service.engines.state import state_of
    from revisit.service.settings_loading import load_settings

    # Files are for this user only.
    os.umask(0o077)
    settings = load_settings(home)
    try:
        state = state_of(settings.home, settings.database_url)
        state.migrate()
    except ForeignSchema as error:
        raise refuse(f"the database {state.name} does not fit this version: {error}") from error
    except UnusableServer as error:
        raise refuse(str(error)) from error
    with offline_use_cases(settings) as use_cases:
        yield use_cases

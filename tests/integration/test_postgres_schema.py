"""Every step of the schema runs on both engines and leaves the same tables; a version knows on which it may run."""

from __future__ import annotations

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import create_engine, inspect

from revisit.service.domain.errors import StorageUncertain
from revisit.service.engines import schema
from revisit.service.engines.postgres import migration
from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.schema import NEWEST_REVISION, ForeignSchema, UnusableServer
from revisit.service.engines.sql.tables import metadata
from tests.support.made_database import made_database
from tests.support.next_migration import NEXT_REVISION, migrations_with_a_next_step

NARROW = {"INTEGER", "SMALLINT"}
OWN = {"alembic_version", "schema_accepts", "audit_height", "boots"}
"""Tables of an engine alone."""


def described(engine):
    """Table -> its columns, keys, references and indexes, in words that both engines share."""
    reflected = inspect(engine)
    return {
        table: {
            "columns": {c["name"]: (family(c["type"]), c["nullable"]) for c in reflected.get_columns(table)},
            "key": reflected.get_pk_constraint(table)["constrained_columns"],
            "unique": {tuple(c["column_names"]) for c in reflected.get_unique_constraints(table)},
            "references": {
                (tuple(c["constrained_columns"]), c["referred_table"]) for c in reflected.get_foreign_keys(table)
            },
            "indexes": {
                i["name"]: i["column_names"] for i in reflected.get_indexes(table) if not i.get("duplicates_constraint")
            },
        }
        for table in set(reflected.get_table_names()) - OWN
    }


def family(kind) -> str:
    name = str(kind)
    return {"INTEGER": "BIGINT", "FLOAT": "DOUBLE PRECISION", "BLOB": "BYTEA"}.get(name, name)


def test_both_engines_have_the_same_schema(postgres_url, tmp_path):
    engines = [create_engine(f"sqlite:///{made_database(tmp_path / 'test.db')}"), create_engine(postgres_url)]
    sqlite, postgres = (described(engine) for engine in engines)
    for engine in engines:
        engine.dispose()
    assert sqlite.keys() == postgres.keys() and len(postgres) > 20
    for table, parts in sqlite.items():
        assert postgres[table] == parts, table


def test_no_number_of_a_row_has_less_than_64_bits(postgres_url):
    engine = create_engine(postgres_url)
    columns = [
        (t, c["name"], str(c["type"]))
        for t in inspect(engine).get_table_names()
        for c in inspect(engine).get_columns(t)
    ]
    engine.dispose()
    assert [column for column in columns if column[2] in ("INTEGER", "SMALLINT")] == []


def test_the_tables_that_statements_are_made_of_are_those_of_the_schema(postgres_url):
    engine = create_engine(postgres_url)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": False})
        found = [step for step in compare_metadata(context, metadata) if not is_own(step)]
    engine.dispose()
    assert found == []


def is_own(step) -> bool:
    """A table of the engine alone, or the checksum of a row, which SQLite keeps."""
    if step[0] == "remove_table":
        return step[1].name in OWN
    return step[0] == "remove_column" and step[3].name == "checksum"


def test_a_second_migration_finds_nothing_to_do_and_a_way_back_leads_to_an_empty_database(postgres_url):
    migration.migrate(postgres_url)
    assert migration.current_revision(postgres_url) == NEWEST_REVISION
    migration.migrate(postgres_url, "base")
    assert migration.current_revision(postgres_url) is None
    engine = create_engine(postgres_url)
    assert set(inspect(engine).get_table_names()) <= {"alembic_version", "schema_accepts"}
    engine.dispose()
    migration.migrate(postgres_url)
    migration.require_fitting(postgres_url)


@pytest.mark.parametrize(("runs_from", "fits"), [(NEWEST_REVISION, True), (NEXT_REVISION, False)])
def test_an_older_version_runs_on_a_newer_schema_that_says_so(postgres_url, tmp_path, runs_from, fits):
    with pytest.MonkeyPatch.context() as later:
        later.setattr(schema, "MIGRATIONS", migrations_with_a_next_step(tmp_path))
        later.setattr(schema, "NEWEST_REVISION", NEXT_REVISION)
        (step,) = (tmp_path / "migrations" / "versions").glob(f"{NEXT_REVISION}*.py")
        step.write_text(f'{step.read_text()}\nruns_from = "{runs_from}"\n')
        migration.migrate(postgres_url)
        assert migration.current_revision(postgres_url) == NEXT_REVISION
    if fits:
        migration.require_fitting(postgres_url)
        migration.migrate(postgres_url)
        assert migration.current_revision(postgres_url) == NEXT_REVISION
    else:
        with pytest.raises(ForeignSchema):
            migration.require_fitting(postgres_url)
        with pytest.raises(ForeignSchema, match="newer Revisit"):
            migration.migrate(postgres_url)


def test_what_is_no_address_of_postgresql_is_refused():
    for address in ("mysql://host/name", "nonsense"):
        with pytest.raises(UnusableServer, match="REVISIT_DATABASE_URL"):
            server_url(address)


@pytest.mark.parametrize("encoding", ["LATIN1", "SQL_ASCII"])
def test_a_database_in_another_encoding_is_refused_with_what_to_do(postgres_url, encoding):
    server = create_engine(postgres_url, isolation_level="AUTOCOMMIT")
    with server.connect() as connection:
        connection.exec_driver_sql("DROP DATABASE IF EXISTS otherwise")
        connection.exec_driver_sql(f"CREATE DATABASE otherwise TEMPLATE template0 ENCODING '{encoding}' LOCALE 'C'")
    server.dispose()
    with pytest.raises(UnusableServer, match="TEMPLATE template0 ENCODING 'UTF8' LOCALE 'C'"):
        migration.migrate(postgres_url.set(database="otherwise"))


def test_a_server_that_does_not_answer_is_told_apart_from_one_that_cannot_be_used():
    with pytest.raises(StorageUncertain, match="the database failed"):
        migration.migrate(server_url("postgresql://nobody@127.0.0.1:1/none"))


def test_clients_are_not_told_where_the_database_is_and_operators_are():
    with pytest.raises(StorageUncertain) as told:
        migration.current_revision(server_url("postgresql://nobody@127.0.0.1:1/none"))
    assert "127.0.0.1" in told.value.reason
    assert "127.0.0.1" not in told.value.message

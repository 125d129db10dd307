"""Starting: commands, refusals and logs."""

from __future__ import annotations

import json
import logging
import socket
import sqlite3

import pytest
import structlog
from alembic.script import ScriptDirectory

from revisit.cli.app import run
from revisit.service.__main__ import main
from revisit.service.composition import build_context
from revisit.service.domain.errors import RateLimited
from revisit.service.engines.local.sqlite.migration import current_revision
from revisit.service.engines.schema import MIGRATIONS, NEWEST_REVISION
from revisit.service.settings import Settings
from revisit.service.telemetry import configure_logging


@pytest.fixture(autouse=True)
def home(monkeypatch, tmp_path):
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path))
    yield tmp_path
    structlog.reset_defaults()
    logging.basicConfig(force=True, handlers=[logging.NullHandler()])


def test_migrate_makes_the_database_and_takes_it_away_again(home):
    assert main(["migrate"]) == 0
    assert current_revision(home / "revisit.db") == NEWEST_REVISION
    assert ScriptDirectory(str(MIGRATIONS)).get_current_head() == NEWEST_REVISION
    assert (home / "revisit.db").stat().st_mode & 0o077 == 0
    assert main(["migrate", "--revision", "base"]) == 0
    assert current_revision(home / "revisit.db") is None


def test_a_database_of_a_newer_version_is_refused_and_left_alone(home, capsys):
    main(["migrate"])
    with sqlite3.connect(home / "revisit.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    assert main(["migrate"]) == 78
    assert "does not fit this version" in capsys.readouterr().err
    assert current_revision(home / "revisit.db") == "9999"


def test_a_database_of_a_newer_version_is_told_without_words_of_the_migrations(home, capsys):
    main(["migrate"])
    with sqlite3.connect(home / "revisit.db") as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    assert main(["migrate"]) == 78
    told = capsys.readouterr().err
    assert f"it was written by a newer Revisit (schema 9999, this one knows up to {NEWEST_REVISION})" in told
    assert "newer version, or restore a backup" in told and "revision" not in told and told.count("\n") == 1


@pytest.mark.parametrize(
    ("variable", "nearest"),
    [
        ("REVISIT_WORKRES", "REVISIT_WORKERS"),
        ("REVISIT_HOEM", "REVISIT_HOME"),
        ("REVISIT_HTTPPORT", "REVISIT_HTTP_PORT"),
        ("REVISIT_TAU", "REVISIT_TAU_M"),
    ],
)
def test_a_misspelt_setting_ends_the_start_with_the_nearest_name(variable, nearest, monkeypatch, capsys):
    monkeypatch.setenv(variable, "4")
    assert main(["serve"]) == 78
    assert capsys.readouterr().err == f"{variable} is no setting: did you mean {nearest}?\n"


def test_a_setting_that_is_gone_ends_the_start_with_what_stands_in_its_place(monkeypatch, capsys):
    monkeypatch.setenv("REVISIT_MAP_VERSIONS_KEPT", "7")
    assert main(["serve"]) == 78
    assert capsys.readouterr().err == "REVISIT_MAP_VERSIONS_KEPT is gone: 20 versions of a map are kept. Unset it\n"


def test_a_command_refuses_a_misspelt_setting_in_one_line(monkeypatch, capsys):
    monkeypatch.setenv("REVISIT_HOEM", "elsewhere")
    monkeypatch.setattr("sys.argv", ["revisit", "keys", "list"])
    with pytest.raises(SystemExit) as refused:
        run()
    assert refused.value.code == 1
    assert capsys.readouterr().err == "revisit: REVISIT_HOEM is no setting: did you mean REVISIT_HOME?\n"


FOREIGN = ("SERVICE_HOST", "SERVICE_PORT", "SERVICE_PORT_HTTP", "PORT", "PORT_8080_TCP_ADDR", "DATA", "TEST_TIMES")


def test_variables_of_clients_of_tests_and_of_kubernetes_are_no_misspelt_settings(monkeypatch):
    # Kubernetes sets REVISIT_PORT and others in every container beside a service named revisit.
    for name in (*FOREIGN, "URL", "GRPC", "API_KEY", "CA", "CERTIFICATE", "CERTIFICATE_KEY"):
        monkeypatch.setenv(f"REVISIT_{name}", "1")
    assert main(["migrate"]) == 0


@pytest.mark.parametrize("command", ["serve", "migrate", "worker"])
def test_a_file_that_is_no_database_is_refused_in_one_line_and_left_alone(command, home, capsys):
    (home / "revisit.db").write_bytes(b"no database" * 500)
    assert main([command]) == 78
    told = capsys.readouterr().err
    assert "revisit.db cannot be read: file is not a database" in told and told.count("\n") == 1
    assert (home / "revisit.db").read_bytes() == b"no database" * 500


def test_a_folder_in_place_of_the_database_is_refused(home, capsys):
    (home / "revisit.db").mkdir()
    assert main(["serve"]) == 78
    assert "revisit.db cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["serve", "migrate", "worker"])
def test_a_database_whose_pages_are_damaged_is_refused_in_one_line(command, home, capsys):
    assert main(["migrate"]) == 0
    pages = bytearray((home / "revisit.db").read_bytes())
    # All but the first one, which is the header.
    pages[4096:] = b"\xff" * (len(pages) - 4096)
    (home / "revisit.db").write_bytes(pages)
    assert main([command]) == 78
    told = capsys.readouterr().err
    assert "revisit.db cannot be read: database disk image is malformed" in told and told.count("\n") == 1


def test_a_data_folder_that_cannot_be_made_is_named(home, capsys, monkeypatch):
    (home / "file").write_text("")
    monkeypatch.setenv("REVISIT_HOME", str(home / "file"))
    assert main(["serve"]) == 78
    assert f"cannot use {home / 'file'}: File exists; REVISIT_HOME" in capsys.readouterr().err


def test_a_worker_without_a_database_is_refused(capsys):
    assert main(["worker"]) == 78
    assert "migrate" in capsys.readouterr().err


def test_a_worker_that_never_showed_itself_is_not_seen(capsys):
    assert main(["seen", "--id", "w"]) == 78
    main(["migrate"])
    assert main(["seen", "--id", "w"]) == 78
    assert "not shown itself" in capsys.readouterr().err


def test_a_worker_that_beats_is_seen(home):
    main(["migrate"])
    context = build_context(Settings(), gateway=False)
    context.transactions.write(lambda uow: uow.workers.beat("w", "fake-1")).result()
    context.transactions.close()
    assert main(["seen", "--id", "w"]) == 0
    assert main(["seen", "--id", "other"]) == 78


def test_whoever_a_rate_limit_refuses_comes_at_a_slower_pace():
    main(["migrate"])
    context = build_context(Settings(), gateway=False)
    context.transactions.close()
    context.in_flight.charge_call("acme", 10**12)
    assert context.pace._refused_until_s == {}
    with pytest.raises(RateLimited):
        context.in_flight.check_rate("acme")
    assert [tenant for _, tenant, _ in context.pace._refused_until_s] == ["acme"]
    assert context.pace._others_wait == context.in_flight.others_wait


def test_a_setting_that_cannot_be_used_is_named_as_its_variable(monkeypatch, capsys):
    monkeypatch.setenv("REVISIT_HTTP_PORT", "99999")
    assert main(["serve"]) == 78
    assert capsys.readouterr().err.startswith("REVISIT_HTTP_PORT: ")


def test_a_port_in_use_is_named_with_the_setting_that_changes_it(monkeypatch, capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        monkeypatch.setenv("REVISIT_HTTP_PORT", str(port))
        assert main(["serve"]) == 78
    said = capsys.readouterr().err
    assert f"port {port} for HTTP" in said and "REVISIT_HTTP_PORT" in said


def test_an_unknown_log_level_is_refused(monkeypatch, capsys):
    monkeypatch.setenv("REVISIT_LOG_LEVEL", "LOUD")
    assert main(["migrate"]) == 78
    assert "LOUD" in capsys.readouterr().err


def test_logs_are_json_lines_with_the_ids_that_are_bound(capsys):
    configure_logging("INFO")
    with structlog.contextvars.bound_contextvars(request_id="r-1"):
        structlog.get_logger("test").info("posted", submap="a\nb")
    logging.getLogger("library").warning("look %s", "here")
    logging.getLogger("library").info("not this")
    ours, theirs = (json.loads(line) for line in capsys.readouterr().err.splitlines())
    assert (ours["event"], ours["request_id"], ours["submap"], ours["level"]) == ("posted", "r-1", "a\nb", "info")
    assert (theirs["event"], theirs["logger"], theirs["level"]) == ("look here", "library", "warning")


@pytest.mark.parametrize("command", [["keys", "list"], ["scrub"], ["backup", "elsewhere"]])
def test_commands_say_in_one_line_that_the_database_is_damaged(command, home, capsys, monkeypatch):
    (home / "revisit.db").write_bytes(b"no database" * 500)
    monkeypatch.chdir(home)
    monkeypatch.setattr("sys.argv", ["revisit", *command])
    with pytest.raises(SystemExit) as ended:
        run()
    told = capsys.readouterr().err
    assert ended.value.code == 1
    assert "the database cannot be read: file is not a database" in told and told.count("\n") == 1
    assert not (home / "elsewhere").exists()

"""Deliberate faults: edits of the source that each break one promise, applied to a copy, and the test that must notice.

A harness that never fails proves nothing. Whoever changes the code an edit names changes the edit with it: one that no
longer fits is itself a failure.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
COPIED = ("service", "revisit", "migrations", "tests", "pyproject.toml")
LINKED = ("core", "evaluation", "scripts", "docs", "proto", "docker")

POWER_CUT = "tests/faults/test_power_cut.py::test_a_power_cut_takes_nothing_that_was_acknowledged[1000]"
CRASH = "tests/faults/test_crash_points.py::"
QUEUE = "tests/contract/test_job_queue.py::"
DELETION = "tests/contract/api/test_api_session_deletion.py::"


@dataclass(frozen=True)
class Edit:
    """Replace `old`, which occurs once in the file, by `new`."""

    path: str
    old: str
    new: str


@dataclass(frozen=True)
class Sabotage:
    """A broken promise: what is broken, the edits that break it, the test that must fail, and whether that is quick."""

    name: str
    edits: tuple[Edit, ...]
    test: str
    quick: bool = False


class DoesNotFit(AssertionError):
    """The code that an edit names has changed: change the edit too."""


SABOTAGES = (
    Sabotage(
        "a commit does not wait for the disk",
        (Edit("service/adapters/sqlite/connections.py", '"synchronous": 2,', '"synchronous": 1,'),),
        POWER_CUT,
    ),
    Sabotage(
        "the client is told before the commit",
        (
            Edit(
                "service/adapters/sqlite/group_commit.py",
                "                    outcomes.append(_attempt(connection, write))\n",
                "                    outcomes.append(_attempt(connection, write))\n"
                "                    outcomes[-1].tell()\n                    time.sleep(0.05)\n",
            ),
            Edit("service/adapters/sqlite/group_commit.py", "            outcome.tell()\n", "            pass\n"),
        ),
        f"{CRASH}test_an_undisturbed_drive_leaves_nothing_to_complain_about",
    ),
    Sabotage(
        "a query does not wait for what it must rest on",
        (Edit("service/application/query/freshness.py", "min_seq == 0:\n", "min_seq >= 0:\n"),),
        "tests/contract/api/test_api_read_your_writes.py::test_a_query_waits_for_what_its_own_client_has_posted",
        quick=True,
    ),
    Sabotage(
        "a blob is not synced",
        (Edit("service/adapters/files/durable_files.py", "            os.fsync(file.fileno())\n", ""),),
        POWER_CUT,
    ),
    Sabotage(
        "the directory of a blob is not synced",
        (
            Edit(
                "service/adapters/files/durable_files.py",
                'failpoint("blob.before_directory_sync")\n    sync_directory(path.parent)\n',
                'failpoint("blob.before_directory_sync")\n',
            ),
        ),
        POWER_CUT,
    ),
    Sabotage(
        "a described submap does not enter the index",
        (
            Edit(
                "service/application/recognise/description_commit.py",
                "        uow.changes.record_described(row.tenant, self.task.map.number, row.number)\n",
                "",
            ),
        ),
        f"{CRASH}test_an_undisturbed_drive_leaves_nothing_to_complain_about",
    ),
    Sabotage(
        "a repeated request runs its job again",
        (
            Edit(
                "service/application/catalogue/submaps.py",
                "        if known is not None:\n            return known\n        # A delete",
                "        if known is not None:\n"
                "            job = uow.jobs.get(row.tenant, known.operation.operation_id)\n"
                '            uow.jobs.replace(replace(job, state="QUEUED"))\n'
                "            return known\n        # A delete",
            ),
            Edit(
                "service/application/catalogue/submaps.py",
                "        if known is not None:\n            return known\n        await",
                "        await",
            ),
        ),
        f"{CRASH}test_a_drive_that_is_repeated_runs_none_of_its_jobs_again",
    ),
    Sabotage(
        "other content is taken under a used id",
        (Edit("service/application/catalogue/submaps.py", "if known.content_hash != row.content_hash:", "if False:"),),
        "tests/integration/test_use_cases.py::"
        "test_a_repeated_post_gives_the_first_answer_and_another_content_is_refused",
        quick=True,
    ),
    Sabotage(
        "a key can be used twice",
        (
            Edit(
                "migrations/versions/0001_initial_schema.py",
                '        sa.UniqueConstraint("tenant", "operation_id", name="uq_jobs_tenant_operation_id"),\n',
                "",
            ),
        ),
        "tests/integration/test_sqlite.py::test_the_migration_makes_the_schema_of_the_tables",
    ),
    Sabotage(
        "a late result is taken",
        (Edit("service/adapters/leased_jobs.py", " or job.lease_token != lease.job.lease_token", ""),),
        f"{QUEUE}test_a_late_result_is_refused_by_its_token",
        quick=True,
    ),
    Sabotage(
        "the attempt is counted after the run",
        (Edit("service/adapters/leased_jobs.py", "attempts=job.attempts + 1,", "attempts=job.attempts,"),),
        f"{QUEUE}test_the_attempt_is_counted_before_the_run",
    ),
    Sabotage(
        "a tenant sees the rows of others",
        (Edit("service/adapters/sql/statements.py", '{"tenant": tenant, **equals}', "dict(equals)"),),
        "tests/contract/test_transactions.py::test_find_filters_pages_and_keeps_the_tenant",
        quick=True,
    ),
    Sabotage(
        "any number of hits may be asked for",
        (
            Edit(
                "service/application/query/search_answers.py", "if not 1 <= criteria.k <= MAX_K:", "if criteria.k < 1:"
            ),
        ),
        "tests/contract/api/test_api_bad_input.py::test_k_out_of_1_to_100_is_refused",
    ),
    Sabotage(
        "two streams of a session go on side by side",
        (Edit("service/grpc/servicers/ingest.py", "                older.fence()\n", "                pass\n"),),
        "tests/contract/api/test_api_streams.py::test_a_newer_stream_of_the_session_fences_the_older",
    ),
    Sabotage(
        "a gap in a stream is taken",
        (
            Edit(
                "service/application/ingest/scans.py",
                "        raise SequenceGap(session.committed_seq + 1, seq)\n",
                "        pass\n",
            ),
        ),
        "tests/integration/test_use_cases.py::test_a_scan_again_is_acknowledged_and_ignored_and_a_gap_is_refused",
    ),
    Sabotage(
        "a damaged file is served",
        (Edit("service/adapters/files/blobs.py", "if hashlib.sha256(data).hexdigest() != sha256:", "if False:"),),
        "tests/contract/test_blob_store.py::test_a_damaged_file_is_refused",
    ),
    Sabotage(
        "after a failed sync the service goes on",
        (Edit("service/adapters/files/fail_stop.py", "        if self._tripped:\n", "        if False:\n"),),
        "tests/integration/test_failing_disk.py::"
        "test_after_a_failed_sync_nothing_is_written_even_if_the_disk_seems_well_again",
    ),
    Sabotage(
        "a key that has expired opens",
        (
            Edit(
                "service/application/access/api_keys.py",
                "    if record.expires_at_ns is not None and record.expires_at_ns <= now_ns:\n",
                "    if False:\n",
            ),
        ),
        "tests/contract/api/test_api_keys.py::test_an_expired_and_a_revoked_key_say_so_to_their_holder_only",
    ),
    Sabotage(
        "a token of any issuer opens",
        (Edit("service/adapters/tokens.py", "            issuer=self._issuer,\n", ""),),
        "tests/unit/service/test_tokens.py::test_a_token_that_is_not_right_in_everything_is_refused",
    ),
    Sabotage(
        "a secret is written to the log",
        (Edit("service/redaction.py", "        text = pattern.sub(replacement, text)\n", "        pass\n"),),
        "tests/unit/service/test_redaction.py::test_no_way_into_the_log_lets_a_secret_through",
    ),
    Sabotage(
        "what is deleted stays in the index",
        (Edit("service/application/catalogue/deletion.py", ", described)\n", ", ())\n"),),
        f"{DELETION}test_a_deleted_session_takes_its_submaps_and_loops_and_nothing_else",
    ),
    Sabotage(
        "the jobs of what is deleted keep their places",
        (
            Edit(
                "service/application/catalogue/deletion.py",
                "        if job is not None and job.state == OperationState.QUEUED:\n",
                "        if False:\n",
            ),
        ),
        f"{DELETION}test_the_waiting_jobs_of_a_deleted_session_are_dropped_at_once",
    ),
    Sabotage(
        "processes are forked",
        (Edit("service/__main__.py", 'set_start_method("spawn", force=True)', 'set_start_method("fork", force=True)'),),
        "tests/unit/service/test_worker.py",
    ),
)


def edited(sabotage: Sabotage, root: Path = ROOT) -> dict[str, str]:
    """The edited files by path. Raises DoesNotFit."""
    texts: dict[str, str] = {}
    for edit in sabotage.edits:
        text = texts.get(edit.path) or (root / edit.path).read_text()
        found = text.count(edit.old)
        if found != 1:
            raise DoesNotFit(
                f"sabotage {sabotage.name!r} no longer fits {edit.path}: {edit.old!r} occurs {found} times, not once. "
                "Change tests/faults/sabotage.py with the code."
            )
        texts[edit.path] = text.replace(edit.old, edit.new)
    return texts


def sabotaged_copy(sabotage: Sabotage, folder: Path) -> Path:
    """A copy of the project in `folder` with the fault in it. Raises DoesNotFit."""
    texts = edited(sabotage)
    folder.mkdir(parents=True, exist_ok=True)
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
    for path, text in texts.items():
        (folder / path).write_text(text)
    return folder


def run_test(root: Path, test: str) -> subprocess.CompletedProcess[str]:
    """Run one test of the project in `root`."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", test]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=900, check=False)

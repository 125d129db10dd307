"""Deliberate faults: behaviour that is patched so that one promise is broken, and the test that must notice.

A harness that never fails proves nothing. A patch is a function that takes what a name of the code stands for and
returns what it is to stand for instead. It is put in place in the process of the test and in all that this one starts,
as soon as the module of that name is imported (see `saboteur`). Whoever renames the code changes the table with it: a
name that is no longer there is itself a failure.
"""

from __future__ import annotations

import asyncio
import importlib
import os
import stat
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any
from unittest import mock

ROOT = Path(__file__).resolve().parents[2]
SABOTEUR = Path(__file__).with_name("saboteur")

CUTS = "250"
POWER_CUT = f"tests/faults/test_power_cut.py::test_a_power_cut_takes_nothing_that_was_acknowledged[{CUTS}]"
CRASH = "tests/faults/test_crash_points.py::"
QUEUE = "tests/contract/test_job_queue.py::"
PLACES = "tests/contract/api/test_api_places.py::"
LIMITS = "tests/contract/api/test_api_limits.py::"
QUOTA = "tests/integration/test_cheap_requests_cost_quota.py::"
WAITS = "tests/contract/api/test_api_waits.py::"
PACE = "tests/contract/api/test_api_pace.py::"
DELETION = "tests/contract/api/test_api_session_deletion.py::"

SERVICE = "revisit.service."
ENGINES = "revisit.service.engines."
LOCAL = "revisit.service.engines.local."

Patch = Callable[[Any], Any]


def nothing(_original: Any) -> Any:
    """Do nothing when called."""
    return lambda *_arguments, **_named: None


def _tell_at_once(attempt):
    def told(committer, connection, write, *, first):
        outcome = attempt(committer, connection, write, first=first)
        if outcome is not None:
            outcome.tell()
            time.sleep(0.05)
        return outcome

    return told


def _tell_once(tell):
    return lambda outcome: None if outcome.write.future.done() else tell(outcome)


def _skip_files(fsync):
    return lambda file: None if stat.S_ISREG(os.fstat(file).st_mode) else fsync(file)


def _skip_directory(durable_write):
    def written(path, data):
        with mock.patch.object(sys.modules[durable_write.__module__], "sync_directory"):
            durable_write(path, data)

    return written


def _run_again(post):
    async def posted(posting, tenant, command):
        answer = await post(posting, tenant, command)

        def requeue(uow):
            uow.jobs.replace(replace(uow.jobs.get(tenant, answer.operation.operation_id), state="QUEUED"))

        if answer.replay:
            await posting._context.storage.write(requeue)
        return answer

    return posted


def _without_constraint(create_all, name):
    def created(metadata, *args, **options):
        for table in metadata.tables.values():
            table.constraints -= {one for one in table.constraints if one.name == name}
        return create_all(metadata, *args, **options)

    return created


def _newest_lease(held):
    def taken(queue, lease):
        job = queue._jobs.get(lease.job.tenant, lease.job.operation_id)
        return held(queue, replace(lease, job=replace(lease.job, lease_id=job.lease_id)))

    return taken


def _uncounted(claim):
    def claimed(queue, *arguments):
        if (lease := claim(queue, *arguments)) is None:
            return None
        job = replace(lease.job, attempts=lease.job.attempts - 1)
        queue._jobs.replace(job)
        return replace(lease, job=job)

    return claimed


def _suppressing(original, error, otherwise):
    """Call `otherwise` where an error of that name is raised."""

    def called(*arguments):
        try:
            return original(*arguments)
        except Exception as raised:
            if type(raised).__name__ != error:
                raise
            return otherwise(*arguments)

    return called


def _never_expires(caller_of_key):
    return lambda record, *shown: caller_of_key(record and replace(record, expires_at_ns=None), *shown)


def _no_slot(_slot):
    return lambda *_arguments, **_named: nullcontext()


def _one_line(init):
    """All tenants are one."""

    def begun(turns, *arguments, **named):
        init(turns, *arguments, **named)
        of = turns.of
        turns.of = lambda _tenant: of("everybody")

    return begun


def _for_every_tenant(keyed_hash):
    return lambda tokens, purpose, _tenant, data: keyed_hash(tokens, purpose, "everybody", data)


def _alone(has_come):
    """Nobody else waits beside the same key."""
    return lambda looks, key, item, within_s: has_come(looks, (key, item), item, within_s)


def _comes_at_once(_waited):
    """What is waited for comes at once."""

    async def come(*_arguments):
        await asyncio.sleep(0)

    return come


async def _at_once(work, *arguments):
    return work(*arguments)


def _asking_again(verify):
    """As it was before a call was asked once, when it begins, for what its caller has shown."""

    async def verified(gate, method, context):
        context.auth_context()
        await verify(gate, method, None)

    return verified


def _settled():
    """An unauthenticated connection that nobody has counted."""


def _without_option(name):
    return lambda server: (
        lambda *arguments, options, **named: server(
            *arguments, options=[option for option in options if option[0] != name], **named
        )
    )


@dataclass(frozen=True)
class Sabotage:
    """A broken promise: what is broken, patches by module:name, the test that must fail, and whether that is quick."""

    name: str
    patches: Mapping[str, Patch]
    test: str
    quick: bool = False

    @property
    def id(self) -> str:
        """Its name as one word."""
        return self.name.replace(" ", "-")


class DoesNotFit(AssertionError):
    """The code that a patch names has changed: change the patch too."""


SABOTAGES = (
    Sabotage(
        "a commit does not wait for the disk",
        {f"{LOCAL}sqlite.connections:WRITER_PRAGMAS": lambda pragmas: {**pragmas, "synchronous": 1}},
        POWER_CUT,
    ),
    Sabotage(
        "the client is told before the commit",
        {
            f"{ENGINES}group_commit:GroupCommitter._attempt": _tell_at_once,
            f"{ENGINES}group_commit:_Outcome.tell": _tell_once,
        },
        f"{CRASH}test_an_undisturbed_drive_leaves_nothing_to_complain_about",
    ),
    Sabotage(
        "a query does not wait for what it must rest on",
        {
            f"{SERVICE}features.waiting.freshness:Freshness.validated": lambda validated: (
                lambda wanted: replace(validated(wanted), min_seq=0)
            )
        },
        "tests/contract/api/test_api_read_your_writes.py::test_a_query_waits_for_what_its_own_client_has_posted",
    ),
    Sabotage("a blob is not synced", {"os:fsync": _skip_files}, POWER_CUT),
    Sabotage(
        "the directory of a blob is not synced",
        {f"{LOCAL}files.disk:durable_write": _skip_directory},
        POWER_CUT,
    ),
    Sabotage(
        "a described submap does not enter the index",
        {f"{ENGINES}sql.change_log:SqlChangeLog.record_described": nothing},
        f"{CRASH}test_an_undisturbed_drive_leaves_nothing_to_complain_about",
    ),
    Sabotage(
        "loops do not wait for those that decide about them",
        {
            f"{SERVICE}features.recognition.turns:_drive": lambda drive: (
                lambda uow, **of: (drive(uow, **of)[0], frozenset(), frozenset())
            )
        },
        "tests/integration/test_order_of_entry.py::"
        "test_loops_wait_for_those_that_decide_about_them_also_where_a_worker_ends",
    ),
    Sabotage(
        "a repeated request runs its job again",
        {f"{SERVICE}features.ingest.posting:SubmapPosting.post": _run_again},
        f"{CRASH}test_a_drive_that_is_repeated_runs_none_of_its_jobs_again",
    ),
    Sabotage(
        "other content is taken under a used id",
        {f"{SERVICE}features.ingest.posting:content_hash": lambda _hash: lambda _content: "the same"},
        "tests/integration/test_use_cases.py::"
        "test_a_repeated_post_gives_the_first_answer_and_another_content_is_refused",
    ),
    Sabotage(
        "a key can be used twice",
        {"sqlalchemy:MetaData.create_all": partial(_without_constraint, name="uq_jobs_tenant_operation_id")},
        "tests/integration/test_sqlite.py::test_the_migration_makes_the_schema_of_the_tables",
    ),
    Sabotage(
        "a late result is taken",
        {f"{ENGINES}leased_jobs:LeasedJobs._held": _newest_lease},
        f"{QUEUE}test_a_late_result_is_refused_by_its_token",
        quick=True,
    ),
    Sabotage(
        "the attempt is counted after the run",
        {f"{ENGINES}leased_jobs:LeasedJobs.claim": _uncounted},
        f"{QUEUE}test_the_attempt_is_counted_before_the_run",
    ),
    Sabotage(
        "a tenant sees the rows of others",
        {f"{ENGINES}sql.repositories:of_tenant": lambda _of_tenant: lambda _tenant, equals: dict(equals)},
        "tests/contract/test_transactions.py::test_find_filters_pages_and_keeps_the_tenant",
        quick=True,
    ),
    Sabotage(
        "any number of hits may be asked for",
        {
            f"{SERVICE}features.index.answers:validated_criteria": lambda validated: (
                lambda criteria: validated(replace(criteria, k=min(criteria.k, 1))) and criteria
            )
        },
        "tests/contract/api/test_api_bad_input.py::test_what_is_out_of_bounds_or_mistyped_is_named_alike_over_both_transports",
    ),
    Sabotage(
        "two streams of a session go on side by side",
        {f"{SERVICE}grpc.scan_streams:_ScanStream.fence": nothing},
        "tests/contract/api/test_api_streams.py::test_a_newer_stream_of_the_session_fences_the_older",
    ),
    Sabotage(
        "a gap in a stream is taken",
        {
            f"{SERVICE}features.ingest.appending:is_replay": partial(
                _suppressing, error="SequenceGap", otherwise=lambda _session, _seq: False
            )
        },
        "tests/integration/test_use_cases.py::test_a_scan_again_is_acknowledged_and_ignored_and_a_gap_is_refused",
    ),
    Sabotage(
        "a damaged file is served",
        {
            f"{LOCAL}files.blobs:read_verified": partial(
                _suppressing, error="BlobDamaged", otherwise=lambda path: path.read_bytes()
            )
        },
        "tests/contract/test_blob_store.py::test_a_damaged_file_is_refused",
    ),
    Sabotage(
        "after a failed sync the service goes on",
        {f"{LOCAL}files.disk:FailStop.require_sound": nothing},
        "tests/integration/test_failing_disk.py::"
        "test_after_a_failed_sync_nothing_is_written_even_if_the_disk_seems_well_again",
    ),
    Sabotage(
        "a key that has expired opens",
        {f"{SERVICE}features.keys.calls:caller_of_key": _never_expires},
        "tests/contract/api/test_api_keys.py::test_an_expired_and_a_revoked_key_say_so_to_their_holder_only",
    ),
    Sabotage(
        "a token of any issuer opens",
        {"jwt:decode": lambda decode: lambda *arguments, issuer, **others: decode(*arguments, **others)},
        "tests/unit/service/test_tokens.py::test_a_token_that_is_not_right_in_everything_is_refused",
    ),
    Sabotage(
        "a secret is written to the log",
        {f"{SERVICE}redaction:redacted": lambda _redacted: lambda text: text},
        "tests/unit/service/test_redaction.py::test_no_way_into_the_log_lets_a_secret_through",
    ),
    Sabotage(
        "what is deleted stays in the index",
        {
            f"{ENGINES}sql.change_log:SqlChangeLog.record_session_removed": nothing,
            "tests.support.memory.repositories:MemoryChangeLog.record_session_removed": nothing,
        },
        f"{DELETION}test_a_deleted_session_takes_its_submaps_and_loops_and_nothing_else",
    ),
    Sabotage(
        "the jobs of what is deleted keep their places",
        {f"{SERVICE}features.deletion.erasure:drop_jobs": nothing},
        f"{DELETION}test_the_waiting_jobs_of_a_deleted_session_are_dropped_at_once",
    ),
    Sabotage(
        "processes are forked",
        {"multiprocessing:set_start_method": lambda set_method: lambda _method, force: set_method("fork", force)},
        "tests/unit/service/test_worker.py::test_a_process_of_the_service_starts_others_afresh_and_never_forks_itself",
    ),
    Sabotage(
        "a stranger may watch health as often as it likes",
        {f"{SERVICE}grpc.public_calls:PublicCalls.watch": _no_slot},
        f"{PLACES}test_whoever_watches_keeps_no_other_tenant_out[stranger-24]",
    ),
    Sabotage(
        "a key may watch loop closures as often as it likes",
        {f"{SERVICE}capacity.call_slots:CallSlots.hold": _no_slot},
        f"{PLACES}test_whoever_watches_keeps_no_other_tenant_out[greedy-32]",
    ),
    Sabotage(
        "two tenants may hold all that there is",
        {f"{SERVICE}capacity.limits:Share.beside": lambda _beside: lambda share, others: share.most - others},
        f"{WAITS}test_two_tenants_that_wait_as_often_as_they_can_keep_no_third_one_out[grpc]",
    ),
    Sabotage(
        "a wait goes on when its client has left",
        {f"{SERVICE}capacity.call_slots:Wait.abandon": nothing},
        f"{WAITS}test_a_wait_whose_client_has_left_ends[rest]",
    ),
    Sabotage(
        "a client that does not read is waited for",
        {f"{SERVICE}rest.slow_clients:DeadlineProtocol._check_writing": nothing},
        f"{LIMITS}test_a_client_that_does_not_read_its_answers_is_cut_off",
    ),
    Sabotage(
        "requests may be pipelined without end",
        {f"{SERVICE}rest.slow_clients:DeadlineProtocol.most_pipelined": lambda _most: 10**6},
        f"{LIMITS}test_requests_in_a_row_that_wait_for_no_answer_are_bounded",
    ),
    Sabotage(
        "health has no places of its own",
        {f"{SERVICE}rest.middleware:HEALTH_PATHS": lambda _paths: frozenset()},
        f"{LIMITS}test_health_is_told_where_every_place_is_taken_and_others_are_told_when_to_come_back",
    ),
    Sabotage(
        "the bytes in flight are not bounded",
        {f"{SERVICE}capacity.byte_budget:ByteBudget.has_room": lambda _has_room: lambda *_arguments: True},
        f"{LIMITS}test_bodies_beyond_what_all_together_may_take_are_refused_until_later",
    ),
    Sabotage(
        "who asks first is served first, whoever it is",
        {f"{SERVICE}capacity.in_flight:Turns.__init__": _one_line},
        "tests/unit/service/test_turns.py::test_tenants_take_turns_and_each_keeps_its_own_order",
    ),
    Sabotage(
        "a refused cloud costs nothing",
        {f"{SERVICE}features.ingest.clouds:reading_points": lambda _points: lambda _cloud: 0},
        f"{QUOTA}test_a_compressed_cloud_that_is_refused_costs_what_it_may_have_been_unpacked_to",
    ),
    Sabotage(
        "a list costs nothing",
        {f"{SERVICE}features.resources.paging:ROW_POINTS": lambda _points: 0},
        f"{QUOTA}test_a_list_costs_by_the_row",
    ),
    Sabotage(
        "refused JSON costs nothing",
        {f"{SERVICE}capacity.admission:Admission.charge_call": nothing},
        f"{QUOTA}test_json_costs_by_the_byte_refused_or_not",
    ),
    Sabotage(
        "JSON of any length is read",
        {f"{SERVICE}rest.schemas:Request.most_bytes": lambda _most: 2**24},
        "tests/contract/api/test_api_http.py::test_strange_json_is_refused_and_nothing_is_stored",
    ),
    Sabotage(
        "a key may begin any number of calls at once",
        {f"{SERVICE}capacity.call_pace:CallPace._wait": _comes_at_once},
        "tests/unit/service/test_call_pace.py::test_a_burst_waits_for_nothing_and_what_follows_comes_at_the_rate",
        quick=True,
    ),
    Sabotage(
        "calls do not wait for their turn",
        {f"{SERVICE}capacity.call_pace:CallPace.turn": _comes_at_once},
        f"{PACE}test_a_key_that_begins_too_many_calls_waits_and_another_does_not[rest]",
    ),
    Sabotage(
        "beside others a tenant has any number of clouds under way",
        {f"{SERVICE}capacity.in_flight:InFlight._let_others_in": _comes_at_once},
        "tests/unit/service/test_in_flight.py::test_beside_others_a_tenant_has_few_clouds_under_way",
        quick=True,
    ),
    Sabotage(
        "a body that is refused unread costs nothing",
        {f"{SERVICE}capacity.call_pace:CallPace.note_unread": nothing},
        f"{PACE}test_a_body_that_is_refused_unread_makes_further_calls_wait",
    ),
    Sabotage(
        "JSON that is read counts as a call, however long it is",
        {f"{SERVICE}capacity.call_pace:CallPace.note_json": nothing},
        f"{PACE}test_long_json_makes_further_calls_wait_whether_it_is_good_or_not",
    ),
    Sabotage(
        "strangers are refused as fast as they ask",
        {f"{SERVICE}capacity.call_pace:CallPace.refusal": _comes_at_once},
        f"{PACE}test_a_stranger_that_is_refused_too_often_waits[rest]",
    ),
    Sabotage(
        "everyone who watches looks at the log",
        {f"{SERVICE}features.waiting.event_tail:EventTail._poll": lambda _poll: lambda tail: tail._read()},
        "tests/unit/service/test_event_tail.py::test_many_who_watch_cause_one_look_at_a_time",
    ),
    Sabotage(
        "everyone who waits looks for the own operation",
        {f"{SERVICE}features.waiting.shared_poll:SharedPoll.has_come": _alone},
        "tests/unit/service/test_shared_poll.py::test_all_that_wait_beside_one_key_are_told_by_one_read",
    ),
    Sabotage(
        "a page token is good for every tenant",
        {f"{SERVICE}features.resources.paging:PageTokens._hash": _for_every_tenant},
        "tests/integration/test_page_tokens.py::test_a_token_of_another_tenant_or_another_service_is_refused",
    ),
    Sabotage(
        "min_seq is compared with the submaps of all tenants",
        {"tests.support.memory.repositories:MemorySubmaps.last_seq": lambda _last: lambda self, *_map: self._rows.last},
        "tests/contract/api/test_api_read_your_writes.py::"
        "test_a_tenant_without_submaps_cannot_find_out_how_many_others_have",
    ),
    Sabotage(
        "a backup needs no signature",
        {"hmac:compare_digest": lambda _compare: lambda *_digests: True},
        "tests/integration/test_backup.py::test_an_edited_database_with_a_matching_manifest_is_refused",
    ),
    Sabotage(
        "the limit of open files stays as it was",
        {f"{SERVICE}open_files:allow_open_files": lambda _allow: lambda: 1024},
        "tests/integration/test_many_sockets.py::"
        "test_beginnings_of_handshakes_beyond_the_soft_limit_keep_nobody_out[http]",
    ),
    Sabotage(
        "a TLS handshake may take as long as it likes",
        {f"{SERVICE}rest.listening:HANDSHAKE_S": lambda _seconds: 60.0},
        "tests/integration/test_many_sockets.py::"
        "test_beginnings_of_handshakes_beyond_the_soft_limit_keep_nobody_out[http]",
    ),
    Sabotage(
        "an ended call is asked for its credential again",
        {
            f"{SERVICE}grpc.access:credential_of": lambda _read: lambda context: context,
            f"{SERVICE}grpc.access:Gate.verify": _asking_again,
        },
        "tests/contract/api/test_api_keys.py::test_a_call_that_has_ended_is_asked_for_nothing_while_its_watch_goes_on",
    ),
    Sabotage(
        "long JSON is parsed on the event loop",
        {"asyncio:to_thread": lambda _to_thread: _at_once},
        "tests/contract/api/test_api_turns.py::"
        "test_long_json_is_parsed_beside_the_event_loop_and_one_of_a_tenant_at_a_time",
    ),
    Sabotage(
        "a tenant has as many lists read at once as it likes",
        {
            f"{SERVICE}capacity.in_flight:Turns.__init__": lambda init: (
                lambda turns, _places, of_tenant=None: init(turns, 99)
            )
        },
        "tests/contract/api/test_api_turns.py::"
        "test_of_many_lists_of_a_tenant_one_is_read_at_a_time_and_others_go_between",
    ),
    Sabotage(
        "newcomers of one address are not bounded",
        {f"{SERVICE}edge.connections:UnauthenticatedConnections.arrive": lambda _arrive: lambda *_arguments: _settled},
        f"{LIMITS}test_newcomers_of_one_address_give_way_to_one_another_and_to_nobody_else",
    ),
    Sabotage(
        "connections of one address may begin as fast as they like",
        {f"{SERVICE}edge.connections:UnauthenticatedConnections.may_begin": lambda _begins: lambda *_arguments: True},
        f"{LIMITS}test_connections_without_a_credential_begin_at_a_pace_and_further_ones_are_sent_away_with_an_answer",
    ),
    Sabotage(
        "calls without a credential do not wait for their turn",
        {f"{SERVICE}capacity.call_pace:CallPace.public": _comes_at_once},
        f"{PACE}test_pages_without_a_key_come_at_a_pace_and_health_is_told_beyond_it",
    ),
    Sabotage(
        "strangers may keep as many connections to gRPC as they like",
        {f"{SERVICE}grpc.open_connections:OpenConnections._count": nothing},
        f"{PLACES}test_connections_of_one_address_over_which_nobody_was_admitted_give_way_to_newer_ones",
    ),
    Sabotage(
        "there may be any number of connections to gRPC",
        {"grpc.aio:server": _without_option("grpc.max_allowed_incoming_connections")},
        f"{PLACES}test_connections_beyond_those_that_may_be_open_are_closed_at_once_until_one_is_free",
    ),
    Sabotage(
        "the image is open without a key",
        {f"{SERVICE}access_settings:AccessSettings.credential_required": lambda _required: False},
        "tests/integration/test_closed_image.py::"
        "test_nobody_gets_in_before_the_first_key_and_its_owner_does_afterwards",
    ),
    Sabotage(
        "the log is never folded back",
        {f"{LOCAL}sqlite.checkpoints:Checkpoints.tend": nothing},
        "tests/integration/test_log_is_folded_back.py::test_a_log_that_only_workers_write_stays_short",
    ),
    Sabotage(
        "a tenant stores as much as it likes",
        {f"{SERVICE}capacity.storage_quota:StorageQuota._reached": lambda _reached: lambda *_arguments: False},
        "tests/contract/api/test_api_storage_quota.py::test_scans_count_and_what_another_tenant_has_does_not",
    ),
    Sabotage(
        "a run that was cut short counts",
        {f"{ENGINES}leased_jobs:LeasedJobs.forgive": lambda _forgive: lambda _queue, _family: 0},
        f"{QUEUE}test_a_service_that_starts_again_forgives_the_runs_that_were_under_way_once",
    ),
    Sabotage(
        "jobs cost their tenant nothing",
        {f"{ENGINES}fair_turns:FairTurns.end": nothing},
        f"{QUEUE}test_tenants_share_the_time_of_the_workers_not_their_number_of_jobs",
    ),
    Sabotage(
        "two gateways serve one data folder",
        {f"{LOCAL}files.home_lock:try_lock": lambda _try: lambda _descriptor: True},
        "tests/integration/test_one_gateway.py::"
        "test_a_second_gateway_on_one_data_folder_is_refused_and_the_first_goes_on",
    ),
    Sabotage(
        "two backups fill one folder",
        {f"{LOCAL}sqlite.backup:try_lock": lambda _try: lambda _descriptor: True},
        "tests/integration/test_backup.py::test_of_two_backups_into_one_folder_at_once_one_is_refused",
    ),
    Sabotage(
        "an old window of any number of points is loaded whole",
        {f"{SERVICE}features.ingest.rows:marked_rows": lambda _marked: lambda poses, _marks: range(len(list(poses)))},
        "tests/unit/service/test_submap_source.py::"
        "test_an_old_window_of_many_large_scans_takes_a_worker_the_memory_of_a_few[slow]",
    ),
)


def named(name: str) -> Sabotage:
    """The sabotage of this name."""
    return next(sabotage for sabotage in SABOTAGES if sabotage.name == name)


def holder_of(module: Any, name: str) -> tuple[Any, str]:
    """The module or class that a dotted name of `module` belongs to, and its last part. Raises DoesNotFit."""
    *path, last = name.split(".")
    holder = module
    for part in path:
        holder = getattr(holder, part, None)
    if not hasattr(holder, last):
        raise DoesNotFit(f"{module.__name__} has no {name}: change tests/faults/sabotage.py with the code")
    return holder, last


def require_targets(sabotage: Sabotage) -> None:
    """Raises DoesNotFit for a sabotage of something that is not there."""
    for target in sabotage.patches:
        module, _, name = target.partition(":")
        try:
            holder_of(importlib.import_module(module), name)
        except ImportError as error:
            raise DoesNotFit(f"there is no {module}: change tests/faults/sabotage.py with the code") from error


def install(sabotage: Sabotage) -> None:
    """Patch this process: modules that are imported at once, others when they are."""
    by_module: dict[str, dict[str, Patch]] = defaultdict(dict)
    for target, patch in sabotage.patches.items():
        module, _, name = target.partition(":")
        by_module[module][name] = patch
    for module in by_module.keys() & sys.modules.keys():
        _patch(sys.modules[module], by_module.pop(module))
    sys.meta_path.insert(0, _PatchedImports(by_module))


def _patch(module: Any, patches: Mapping[str, Patch]) -> None:
    for name, patch in patches.items():
        holder, last = holder_of(module, name)
        setattr(holder, last, patch(getattr(holder, last)))


class _PatchedImports(MetaPathFinder):
    """Patches modules between their own last line and the first import of a name from them."""

    def __init__(self, patches: Mapping[str, Mapping[str, Patch]]) -> None:
        self._patches = patches

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """See `MetaPathFinder`."""
        spec = PathFinder.find_spec(fullname, path) if fullname in self._patches else None
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module

            def exec_module(module: Any) -> None:
                run(module)
                _patch(module, self._patches[fullname])

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec


def run_test(*tests: str, sabotage: Sabotage | None = None) -> subprocess.CompletedProcess[str]:
    """Run pytest in a process that is sabotaged, with no more plugins than it needs: imports take longest."""
    plugins = ("-p", "pytest_asyncio.plugin", "-p", "pytest_timeout", "-p", "no:cacheprovider")
    command = [sys.executable, "-m", "pytest", "-x", "-q", *plugins, *tests]
    environment = {**os.environ, "SABOTAGE": sabotage.name if sabotage else "", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    environment["REVISIT_TEST_POWER_CUTS"] = CUTS
    environment["REVISIT_TEST_PATIENCE_S"] = "30"  # what is broken is waited for in vain
    environment["PYTHONPATH"] = os.pathsep.join([str(SABOTEUR), str(ROOT)])
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900, check=False)

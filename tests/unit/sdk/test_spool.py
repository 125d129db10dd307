"""The spool on a robot's disk: durable, bounded, emptied by acknowledgements alone."""

from __future__ import annotations

import json
import sqlite3
import stat
import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from revisit.core.scan_marks import ScanMarks
from revisit.sdk import spool as spool_module
from revisit.sdk.clouds import Cloud
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.spool import Spool, SpoolDisagrees, SpoolFull, SpoolUnusable
from revisit.sdk.spooled_stream import SpoolSender

ROOT = Path(__file__).resolve().parents[3]
POSE = {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
MONDAY = "maps/town/sessions/monday"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "robot.spool"


@pytest.fixture
def spool(path):
    opened = Spool(path, MONDAY, max_bytes=100)
    yield opened
    opened.close()


def put(spool, *stamps, size=10, content_type="a/b"):
    for stamp_ns in stamps:
        spool.append(Cloud(bytes([stamp_ns]) * size, content_type), POSE, stamp_ns)


def stamps(spool):
    found, number = [], 0
    while (scan := spool.after(number, timeout_s=0.0)) is not None:
        found.append(scan.stamp_ns)
        number = scan.number
    return found


def counts(spool):
    return spool.state.pending, spool.state.pending_bytes


def test_scans_come_back_in_order_as_they_were_put(spool):
    put(spool, 1, 2, 3)
    scan = spool.after(0, timeout_s=0.0)
    assert (scan.stamp_ns, scan.pose, scan.cloud) == (1, POSE, Cloud(b"\x01" * 10, "a/b"))
    assert stamps(spool) == [1, 2, 3]
    assert counts(spool) == (3, 30)


def test_a_scan_that_comes_after_all_were_sent_is_behind_them(spool):
    put(spool, 1, 2)
    spool.committed(2)
    put(spool, 3)
    scan = spool.after(2, timeout_s=0.0)
    assert scan is not None and scan.stamp_ns == 3


def test_what_was_put_is_there_after_the_spool_is_opened_again(path):
    first = Spool(path, MONDAY)
    put(first, 1, 2)
    first.opened(5, "token")
    first.committed(6)
    first.close()
    again = Spool(path, MONDAY)
    assert stamps(again) == [2]
    assert again.resume_point() == ("token", 6)
    assert (again.state.committed_seq, again.state.last_stamp_ns, counts(again)) == (6, 2, (1, 10))
    again.close()


def test_a_process_that_is_killed_leaves_every_scan_it_has_put(path):
    script = (
        "import os, sys; from pathlib import Path; from revisit.sdk.clouds import Cloud\n"
        "from revisit.sdk.spool import Spool\n"
        f"spool = Spool(Path(sys.argv[1]), {MONDAY!r})\n"
        "for stamp in range(1, 8):\n"
        "    spool.append(Cloud(bytes(1000), 'a/b'), {}, stamp)\n"
        "    print(stamp, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    ended = subprocess.run([sys.executable, "-c", script, path], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == -9, ended.stderr
    spool = Spool(path)
    assert stamps(spool) == [int(line) for line in ended.stdout.split()] == list(range(1, 8))
    spool.close()


def test_a_commit_is_on_disk_before_it_is_told(spool):
    assert spool._db.execute("PRAGMA synchronous").fetchone() == (2,)
    assert spool._db.execute("PRAGMA journal_mode").fetchone() == ("wal",)


def test_a_full_spool_refuses_and_loses_nothing(spool):
    put(spool, *range(1, 11))
    with pytest.raises(SpoolFull, match="100 of 100 bytes"):
        put(spool, 11, size=1)
    assert stamps(spool) == list(range(1, 11))
    assert spool.state.last_stamp_ns == 10
    spool.opened(0, "")
    spool.committed(1)
    put(spool, 11)
    assert stamps(spool) == list(range(2, 12))


def test_a_full_spool_waits_for_room_where_it_is_told_to(spool):
    put(spool, *range(1, 11))
    spool.opened(0, "")
    freed = threading.Timer(0.05, lambda: spool.committed(2))
    freed.start()
    spool.append(Cloud(bytes(15), "a/b"), POSE, 11, wait_s=20.0)
    freed.join()
    assert counts(spool) == (9, 95)


def test_acknowledged_scans_leave_and_no_others(spool):
    put(spool, 1, 2, 3)
    spool.opened(40, "")  # what the session had before did not come from here
    assert stamps(spool) == [1, 2, 3]
    spool.committed(42)
    assert stamps(spool) == [3]
    spool.committed(42)
    spool.opened(42, "")
    assert stamps(spool) == [3]


def test_a_refused_scan_becomes_a_dead_letter_and_its_successor_takes_its_number(spool):
    put(spool, 1, 2)
    spool.opened(7, "")
    spool.refused(8, "UNUSABLE_CLOUD", "too few points")
    (dead,) = spool.dead_letters()
    assert (dead.seq, dead.stamp_ns, dead.T_odom_sensor, dead.cloud_bytes) == (8, 1, POSE, 10)
    assert (dead.reason, dead.message) == ("UNUSABLE_CLOUD", "too few points")
    assert (stamps(spool), counts(spool), spool.state.dead_letters) == ([2], (1, 10), 1)
    spool.committed(8)
    assert (stamps(spool), counts(spool)) == ([], (0, 0))


def test_a_service_that_has_lost_acknowledged_scans_is_not_sent_more(spool):
    put(spool, 1, 2, 3)
    spool.opened(0, "")
    spool.committed(2)
    with pytest.raises(SpoolDisagrees, match="has 1 scans and had acknowledged 2"):
        spool.opened(1, "")
    assert stamps(spool) == [3]


def test_scans_of_somebody_else_in_the_session_are_not_taken_for_ones_own(spool):
    put(spool, 1, 2)
    spool.opened(0, "")
    with pytest.raises(SpoolDisagrees, match="has 3 scans; only 2 came"):
        spool.opened(3, "")
    assert stamps(spool) == [1, 2]


def test_an_empty_spool_takes_another_session_and_a_filled_one_does_not(path):
    spool = Spool(path, MONDAY)
    put(spool, 1)
    spool.close()
    with pytest.raises(SpoolUnusable, match=f"1 scans of {MONDAY}"):
        Spool(path, "maps/town/sessions/tuesday")
    spool = Spool(path)
    assert spool.state.session == MONDAY
    spool.opened(0, "token")
    spool.committed(1)
    spool.close()
    spool = Spool(path, "maps/town/sessions/tuesday")
    assert (spool.resume_point(), spool.state.last_stamp_ns, spool.state.committed_seq) == (("", 0), None, None)
    spool.close()


def test_a_second_user_of_the_file_is_refused(spool, path):
    with pytest.raises(SpoolUnusable, match="another process"):
        Spool(path, MONDAY)


def test_only_its_owner_may_read_the_file(spool, path):
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_file_that_is_no_spool_or_of_another_format_is_refused(path, tmp_path):
    path.write_bytes(b"something else" * 100)
    with pytest.raises(SpoolUnusable, match="not a database"):
        Spool(path)
    newer = tmp_path / "newer.spool"
    with sqlite3.connect(newer) as connection:
        connection.execute("PRAGMA user_version = 9")
    connection.close()
    with pytest.raises(SpoolUnusable, match="format 9"):
        Spool(newer)


def test_a_full_disk_is_a_full_spool_and_the_scan_may_come_again(spool):
    put(spool, 1)
    (pages,) = spool._db.execute("PRAGMA page_count").fetchone()
    spool._db.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(SpoolFull, match="disk"):
        put(spool, *range(2, 12), content_type="a/b" * 3000, size=9)
    spool._db.execute("PRAGMA max_page_count = 1000000")
    found = stamps(spool)
    assert found[0] == 1 and counts(spool)[0] == len(found)
    put(spool, 99, size=1)
    assert stamps(spool) == [*found, 99]


def test_the_way_and_the_marks_are_there_after_the_spool_is_opened_again(path):
    marks = ScanMarks(2.5, 5, 300_000, 0.5)
    pose = {"translation": {"x": 3.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    first = Spool(path, MONDAY)
    assert (first.marks, first.way) == (None, None)
    first.opened(0, "token", marks)
    first.append(Cloud(b"abc", "a/b"), pose, 1, travelled_m=4.5)
    first.close()
    again = Spool(path, MONDAY)
    assert again.marks == marks
    assert again.way is not None and again.way.travelled_m == 4.5 and again.way.T_odom_sensor[0, 3] == 3.0
    scan = again.after(0, timeout_s=0.0)
    assert scan is not None and scan.travelled_m == 4.5
    again.committed(1)
    again.close()
    other = Spool(path, MONDAY.replace("monday", "tuesday"))
    assert (other.marks, other.way) == (None, None)
    other.close()


def test_marks_of_an_earlier_or_a_later_release_open_a_spool(path):
    """A robot that goes back to the release before it must drive on."""
    marks = ScanMarks(2.5, 5, 300_000, 0.5, 0.025)
    Spool(path, MONDAY).close()
    for told, read in ((asdict(marks) | {"newer": 1}, marks), (asdict(marks), marks)):
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("UPDATE stream SET marks = ?", (json.dumps(told),))
        spool = Spool(path, MONDAY)
        assert spool.marks == read
        spool.close()
    earlier = {name: value for name, value in asdict(marks).items() if name != "least_step_m"}
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("UPDATE stream SET marks = ?", (json.dumps(earlier),))
    spool = Spool(path, MONDAY)
    assert spool.marks == replace(marks, least_step_m=0.0)
    spool.close()


def test_a_spool_of_the_first_format_is_read_and_its_scans_know_no_way(path):
    old = sqlite3.connect(path, isolation_level=None)
    old.executescript(spool_module._SCHEMA)
    old.execute("UPDATE stream SET session = ?, committed_seq = 2, last_stamp_ns = 5", (MONDAY,))
    old.execute("INSERT INTO scans VALUES (1, 5, '{}', 'a/b', x'00')")
    old.close()
    spool = Spool(path, MONDAY)
    scan = spool.after(0, timeout_s=0.0)
    assert scan is not None and (scan.stamp_ns, scan.travelled_m) == (5, None)
    assert (spool.way, spool.marks, spool.resume_point()) == (None, None, ("", 2))
    spool.close()


@pytest.mark.parametrize("error", [RuntimeError("the client has been closed"), ValueError("closed channel")])
def test_a_stream_that_is_closed_while_it_connects_ends_in_silence(path, monkeypatch, error):
    raised, connects, closed = [], threading.Event(), threading.Event()
    monkeypatch.setattr(threading, "excepthook", raised.append)

    class Closing:
        def open_stream(self, *_):
            connects.set()
            assert closed.wait(10)
            raise error

    monkeypatch.setattr("revisit.sdk.spooled_stream.CLOSE_S", 0.0)
    with closing(Spool(path, MONDAY)) as spool:
        sender = SpoolSender(Closing(), MONDAY, spool, RetryPolicy())
        assert connects.wait(10)
        sender.close()
    closed.set()
    sender._thread.join(10)
    assert not sender._thread.is_alive() and raised == [] and sender.error is None

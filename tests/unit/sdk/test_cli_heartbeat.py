"""A command that waits, reads or compiles says so on stderr, also where that is no terminal."""

from __future__ import annotations

import threading

from revisit.cli import output
from revisit.cli.heartbeat import Heartbeat
from revisit.cli.output import progress_bar, reporter
from tests.support.patience import PATIENCE_S


def test_a_stage_of_work_is_told_in_a_line_as_it_begins_and_as_it_ends_where_no_bar_can_be_drawn(capsys):
    with progress_bar(quiet=False) as bar:
        task = bar.add_task("drive: scans", total=30)
        assert capsys.readouterr().err == "drive: scans: 0 of 30\n"
        bar.update(task, completed=30)
    assert capsys.readouterr().err == "drive: scans: 30 of 30\n"


def test_a_quiet_command_tells_no_stages(capsys):
    with progress_bar(quiet=True) as bar:
        bar.add_task("drive: scans", total=30)
    assert capsys.readouterr().err == ""


def test_work_that_takes_long_is_told_once():
    told, heard = [], threading.Event()

    def tell(line):
        told.append(line)
        heard.set()

    with Heartbeat("at work", tell, after_s=0.0, look_s=0.001) as signs:
        assert heard.wait(PATIENCE_S)
        heard.clear()
        signs.doing("reading drive.mcap")
        assert heard.wait(PATIENCE_S)
    assert told == ["at work", "reading drive.mcap"]


def test_nothing_is_told_while_a_bar_shows_how_far_the_work_is():
    told = []
    with Heartbeat("at work", told.append, after_s=0.0, look_s=0.001) as signs, signs.shown():
        assert not signs.is_due()


def test_work_between_two_stages_of_a_bar_is_told_each_time(monkeypatch):
    told, now = [], Heartbeat("at work", lambda _doing: None, after_s=0.0)
    monkeypatch.setattr(output, "signs", now)
    with progress_bar(quiet=False) as bar:
        report = reporter(bar)
        for stage in ("neural maps", "clouds"):
            report(stage, 1, 2)
            told.append(now.is_due())
            report(stage, 2, 2)
            told.append(now.is_due())
    assert told == [False, True, False, True]

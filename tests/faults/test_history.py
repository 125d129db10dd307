"""The checker itself: hand-made histories that are good, and bad ones of which it must say what is wrong."""

from __future__ import annotations

import pytest

from tests.faults.history import History, Kind, Outcome, Stored, sequence_violations, violations

OK, FAIL, UNKNOWN = Outcome.OK, Outcome.FAIL, Outcome.UNKNOWN


def history(*steps: tuple) -> History:
    """Operations one after another, each (kind, key, value, outcome); the clients are c1, c2, ..."""
    made = History()
    for number, (kind, key, value, outcome) in enumerate(steps, start=1):
        made.settle(made.invoke(f"c{number}", kind, key, value), outcome)
    return made


def put(key="a", value="x", outcome=OK):
    return (Kind.PUT, key, value, outcome)


def delete(key="a", outcome=OK):
    return (Kind.DELETE, key, None, outcome)


def read(key="a", value=None, outcome=OK):
    return (Kind.READ, key, value, outcome)


def resume(key="s", value=0, outcome=OK):
    return (Kind.RESUME, key, value, outcome)


GOOD = {
    "what was acknowledged is there": ([put()], {"a": "x"}),
    "an unknown put may be there": ([put(outcome=UNKNOWN)], {"a": "x"}),
    "an unknown put may be absent": ([put(outcome=UNKNOWN)], {}),
    "a refused put is absent": ([put(outcome=FAIL)], {}),
    "a repeat after an unknown outcome settles it": ([put(outcome=UNKNOWN), put()], {"a": "x"}),
    "other content is refused": ([put(), put(value="y", outcome=FAIL)], {"a": "x"}),
    "a deleted key is gone": ([put(), delete()], {}),
    "an unknown delete may have happened": ([put(), delete(outcome=UNKNOWN)], {}),
    "an unknown delete may not have happened": ([put(), delete(outcome=UNKNOWN)], {"a": "x"}),
    "a key may be put again after its deletion": ([put(), delete(), put(value="y")], {"a": "y"}),
    "an unknown put may come true after a delete": ([put(outcome=UNKNOWN), delete()], {"a": "x"}),
    "a read sees what was stored": ([put(), read(value="x")], {"a": "x"}),
    "a read sees nothing after a delete": ([put(), delete(), read()], {}),
    "a stream resumes where it was or later": ([resume(value=3), resume(value=3), resume(value=7)], {}),
}

BAD = {
    "lost": ([put()], {}, "a: acknowledged to c1 and lost"),
    "lost after a refused delete": ([put(), delete(outcome=FAIL)], {}, "a: acknowledged to c1 and lost"),
    "phantom": ([], {"a": "x"}, "a: stored and never sent"),
    "refused but stored": ([put(outcome=FAIL)], {"a": "x"}, "a: stored although it was refused"),
    "foreign content": ([put(outcome=UNKNOWN)], {"a": "z"}, "a: holds z, which nobody sent"),
    "replaced": (
        [put(), put(value="y", outcome=UNKNOWN)],
        {"a": "y"},
        "a: holds y, acknowledged was ['x']",
    ),
    "acknowledged twice": ([put(), put(value="y")], {"a": "x"}, "a: acknowledged with contents ['x', 'y']"),
    "undead": ([put(), delete()], {"a": "x"}, "a: deleted for c2 and still there"),
    "unseen": ([put(), read()], {"a": "x"}, "a: c2 does not see what c1 stored before"),
    "read of nothing sent": ([put(), read(value="z")], {"a": "x"}, "a: c2 reads z, which nobody sent"),
    "resumed too early": ([resume(value=7), resume(value=3)], {}, "s: resumes at 3 after 7"),
}


def rows(final: dict[str, str]) -> list[Stored]:
    return [Stored(key, content) for key, content in final.items()]


@pytest.mark.parametrize(("steps", "final"), GOOD.values(), ids=GOOD)
def test_a_good_history_has_no_violation(steps, final):
    assert violations(history(*steps).operations, rows(final)) == []


@pytest.mark.parametrize(("steps", "final", "problem"), BAD.values(), ids=BAD)
def test_a_bad_history_is_named(steps, final, problem):
    assert problem in violations(history(*steps).operations, rows(final))


def test_a_row_that_is_there_twice_is_a_violation():
    assert violations(history(put()).operations, [Stored("a", "x"), Stored("a", "x")]) == ["a: stored 2 times"]


def test_a_read_that_began_before_the_put_was_settled_may_miss_it():
    made = History()
    putting = made.invoke("writer", Kind.PUT, "a", "x")
    reading = made.invoke("reader", Kind.READ, "a")
    made.settle(putting, OK)
    made.settle(reading, OK)
    assert violations(made.operations, [Stored("a", "x")]) == []


def test_an_operation_that_was_never_settled_counts_as_unknown():
    made = History()
    made.invoke("c", Kind.PUT, "a", "x")
    assert violations(made.operations, []) == violations(made.operations, [Stored("a", "x")]) == []


@pytest.mark.parametrize(
    ("numbers", "committed", "problems"),
    [
        ([1, 2, 3], 3, []),
        ([], 0, []),
        ([1, 3], 3, ["s: gap at 2"]),
        ([1, 2, 2], 2, ["s: 2 is stored 2 times"]),
        ([1, 2, 3], 2, ["s: 3 is stored beyond 2"]),
        ([1], 2, ["s: gap at 2"]),
    ],
)
def test_the_numbers_of_a_stream_are_whole(numbers, committed, problems):
    assert sequence_violations("s", numbers, committed) == problems


def test_a_history_outlives_its_process_but_for_a_line_that_was_cut_off(tmp_path):
    log = tmp_path / "history.jsonl"
    written = History(log)
    written.settle(written.invoke("c1", Kind.PUT, "a", "x"), OK)
    open_put = written.invoke("c2", Kind.PUT, "b", "y")
    whole = log.read_bytes()
    written.settle(open_put, OK)
    assert History.parse(log.read_bytes()).operations == written.operations
    cut = History.parse(log.read_bytes()[: len(whole) + 5])
    assert [(operation.key, operation.outcome) for operation in cut.operations] == [("a", OK), ("b", UNKNOWN)]
    assert cut.operations == History.parse(whole).operations

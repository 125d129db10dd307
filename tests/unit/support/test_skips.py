"""In continuous integration a test that is skipped fails, but for the reasons that are named."""

from __future__ import annotations

import pytest

from revisit.evaluation.real_data import MISSING
from tests import conftest
from tests.support.skips import ALLOWED, IN_CI, judged

LACKING = "strace is not installed"


def skipped(reason: str) -> pytest.TestReport:
    """The report of a test that is skipped, as pytest makes it."""
    where = ("tests/test_promise.py", 1, None)
    return pytest.TestReport(where[0], where, {}, "skipped", (where[0], 1, f"Skipped: {reason}"), "setup")


def test_a_skip_fails_in_continuous_integration_and_says_why():
    report = judged(skipped(LACKING), in_ci=True)
    assert report.failed and LACKING in report.longrepr


def test_a_file_that_is_skipped_fails_there_too():
    file = pytest.CollectReport("tests/test_promise.py", "skipped", ("tests/test_promise.py", 1, "Skipped: none"), [])
    assert judged(file, in_ci=True).failed


def test_a_person_whose_machine_lacks_a_tool_sees_a_skip():
    assert judged(skipped(LACKING), in_ci=False).skipped


@pytest.mark.parametrize("reason", ALLOWED)
def test_a_reason_that_is_named_may_skip_a_test(reason):
    assert judged(skipped(f"{reason}; so it is"), in_ci=True).skipped


def test_an_expected_failure_is_no_skip():
    report = skipped("known")
    report.wasxfail = "known"
    assert judged(report, in_ci=True).skipped


@pytest.mark.parametrize("hook", [conftest.pytest_runtest_makereport, conftest.pytest_make_collect_report])
def test_every_report_of_this_project_is_judged(hook):
    around = hook()
    next(around)
    with pytest.raises(StopIteration) as ended:
        around.send(skipped(LACKING))
    assert ended.value.value.failed == IN_CI


def test_real_data_may_be_absent():
    assert MISSING in ALLOWED

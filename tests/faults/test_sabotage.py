"""Every deliberate fault is noticed by the test that is there for it."""

from __future__ import annotations

import re

import pytest

from tests.faults.power_cut import can_record
from tests.faults.sabotage import POWER_CUT, SABOTAGES, DoesNotFit, Sabotage, nothing, require_targets, run_test

CLUMSY = re.compile(r"tests/faults/sabotage\.py:\d+: (?:Attribute|Import|Key|Name|Type|DoesNotFit)\w*")
"""A patch that fails by itself: it breaks the test, but not the promise."""


def test_every_sabotage_names_code_of_today():
    for sabotage in SABOTAGES:
        require_targets(sabotage)


def test_every_sabotage_names_a_test_of_today():
    ran = run_test("--collect-only", *sorted({sabotage.test for sabotage in SABOTAGES}))
    assert ran.returncode == 0, ran.stdout[-3000:]


@pytest.mark.parametrize("target", ["revisit.service.failpoints:no_such_name", "revisit.no_such_module:name", "os:a.b"])
def test_a_sabotage_of_what_is_not_there_says_so(target):
    with pytest.raises(DoesNotFit, match=r"change tests/faults/sabotage\.py"):
        require_targets(Sabotage("outdated", {target: nothing}, POWER_CUT))


@pytest.mark.parametrize(
    "sabotage",
    [pytest.param(s, id=s.id, marks=[] if s.quick else pytest.mark.slow) for s in SABOTAGES],
)
@pytest.mark.timeout(1000)
def test_a_sabotage_is_noticed(sabotage):
    if sabotage.test == POWER_CUT and can_record():
        pytest.skip(f"power cuts are replayed from what strace records: {can_record()}")
    ran = run_test(sabotage.test, sabotage=sabotage)
    assert ran.returncode == 1, f"{sabotage.test} did not fail:\n{ran.stdout[-3000:]}{ran.stderr[-1000:]}"
    assert "1 failed" in ran.stdout
    assert not CLUMSY.findall(ran.stdout), ran.stdout[-3000:]


def test_without_a_fault_the_same_test_passes():
    quick = next(sabotage for sabotage in SABOTAGES if sabotage.quick)
    ran = run_test(quick.test)
    assert ran.returncode == 0, ran.stdout[-3000:]

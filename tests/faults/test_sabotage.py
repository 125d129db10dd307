"""Every deliberate fault is noticed by the test that is there for it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.faults.power_cut import can_record
from tests.faults.sabotage import POWER_CUT, SABOTAGES, DoesNotFit, Edit, edited, run_test, sabotaged_copy


def named(sabotage) -> str:
    return sabotage.name.replace(" ", "-")


@pytest.mark.parametrize("sabotage", SABOTAGES, ids=named)
def test_a_sabotage_fits_the_code_of_today(sabotage):
    assert all(text.strip() for text in edited(sabotage).values())


def test_a_sabotage_that_no_longer_fits_says_so():
    outdated = replace(SABOTAGES[0], edits=(Edit("service/failpoints.py", "no such line", ""),))
    with pytest.raises(DoesNotFit, match=r"no longer fits service/failpoints.py.*occurs 0 times"):
        edited(outdated)


@pytest.mark.parametrize(
    "sabotage",
    [pytest.param(s, id=named(s), marks=[] if s.quick else pytest.mark.slow) for s in SABOTAGES],
)
@pytest.mark.timeout(1000)
def test_a_sabotage_is_noticed(sabotage, folder):
    if sabotage.test == POWER_CUT and can_record():
        pytest.skip(f"power cuts are replayed from what strace records: {can_record()}")
    ran = run_test(sabotaged_copy(sabotage, folder / "copy"), sabotage.test)
    assert ran.returncode == 1, f"{sabotage.test} did not fail:\n{ran.stdout[-3000:]}{ran.stderr[-1000:]}"
    assert "1 failed" in ran.stdout


def test_the_copy_without_a_fault_passes(folder):
    harmless = replace(SABOTAGES[0], edits=())
    quick = next(sabotage for sabotage in SABOTAGES if sabotage.quick)
    ran = run_test(sabotaged_copy(harmless, folder / "copy"), quick.test)
    assert ran.returncode == 0, ran.stdout[-3000:]

"""The decisions: each has its parts, and their index names each of them in the decision's own words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from scripts import decisions

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted((ROOT / decisions.FOLDER).glob("[0-9]*.md"))
INDEX = (ROOT / decisions.FOLDER / "README.md").read_text()


def written(tmp_path, text):
    page = tmp_path / decisions.FOLDER / "0007-seven.md"
    page.parent.mkdir(parents=True)
    page.write_text(text)
    return page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name[:4])
def test_a_decision_says_what_was_decided_and_what_would_reverse_it(page):
    decision = decisions.read(page)
    assert decision.number == page.name[:4]
    assert {"Status", "Context", "Decision", "What would reverse it"} <= decision.parts.keys()
    assert decision.status.startswith(("Accepted", "Superseded"))
    assert decision.summary


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name[:4])
def test_a_decision_has_its_row_in_the_index(page):
    assert f"| {page.name[:4]} | [{decisions.read(page).title}]({page.name}) |" in INDEX


def test_no_two_decisions_have_the_same_number():
    numbers = [page.name[:4] for page in PAGES]
    assert len(PAGES) > 40
    assert len(set(numbers)) == len(numbers)


def test_a_row_holds_the_first_sentence_of_the_decision_its_status_and_what_would_reverse_it(tmp_path):
    page = "# 0007 Seven\n\n**Status.** Superseded by 0008.\n\n**Context.** None.\n\n"
    page += "**Decision.** Take `a|b`,\nnot c. Because.\n\n**What would reverse it.** An eighth.\n"
    written(tmp_path, page)
    row = "| 0007 | [Seven](0007-seven.md) | Take `a\\|b`, not c. | Superseded by 0008. | An eighth. |"
    assert decisions.index(tmp_path).splitlines()[-1] == row


def test_a_page_without_number_and_title_is_refused(tmp_path):
    with pytest.raises(ValueError, match=re.escape("0007-seven.md must begin with a line `# NNNN title`")):
        decisions.index(written(tmp_path, "Seven\n").parents[2])

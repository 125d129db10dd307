"""The corpus has all 144 rows, each is sent or points to a test that exists, and its files are those of the script."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.corpus.rows import cases
from tests.corpus.write import COMMITTED_BYTES, FILES, bodies

ROOT = Path(__file__).resolve().parents[2]
ROWS = {"G": 58, "T": 12, "S": 10, "I": 12, "J": 9, "Q": 6, "H": 13, "R": 9, "A": 9, "D": 6}
CASES = cases()


def test_every_row_of_the_table_is_here_in_its_order():
    expected = [f"{letter}{number:02}" for letter, count in ROWS.items() for number in range(1, count + 1)]
    assert len(expected) == 144
    assert list(dict.fromkeys(case.row for case in CASES)) == expected


def test_every_row_is_sent_or_covered_by_a_test_elsewhere():
    assert [case.id for case in CASES if not (case.is_run or case.covered_by)] == []


def test_every_case_that_is_sent_says_what_the_answer_must_be():
    for case in CASES:
        if case.is_run and not case.absent:
            assert case.http or case.grpc or case.answers, case.id
        assert not (case.rest and not case.http) and not (case.rpc and not case.grpc), case.id


def functions(path: Path) -> set[str]:
    return {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)} | {
        node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.AsyncFunctionDef)
    }


def test_every_test_that_a_row_points_to_exists():
    for case in CASES:
        for pointer in case.covered_by:
            file, _, name = pointer.partition("::")
            assert (ROOT / file).exists(), (case.id, pointer)
            assert name in functions(ROOT / file), (case.id, pointer)


def test_every_file_that_is_sent_is_made_by_the_script_and_every_file_is_sent():
    sent = {cloud.body for case in CASES for cloud in case.clouds}
    sent |= {entry["body"] for case in CASES for entry in (*case.rest, *case.rpc, *case.scans) if "body" in entry}
    # The good files of the other formats are what damage and fuzzing start from.
    assert sent <= bodies().keys()
    assert {name for name in bodies().keys() - sent if not name.startswith("good.")} == set()


def test_the_committed_files_are_what_the_script_writes():
    made = {name: build() for name, build in bodies().items()}
    small = {name: data for name, data in made.items() if len(data) <= COMMITTED_BYTES}
    assert {file.name: file.read_bytes() for file in FILES.iterdir()} == small

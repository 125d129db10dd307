"""The one error table."""

from __future__ import annotations

import grpc
import pytest

from revisit.core.errors import FORMER_CODES, ErrorCode
from revisit.service.domain.errors import error_of
from revisit.service.status import STATUS


def test_the_table_answers_for_every_code_and_no_other():
    assert set(STATUS) == set(ErrorCode)


def test_every_grpc_code_exists():
    assert {status.grpc for status in STATUS.values()} <= {code.name for code in grpc.StatusCode}


def test_what_is_unknown_or_busy_is_retryable_and_what_is_wrong_is_not():
    for code, status in STATUS.items():
        if status.http in (429, 503, 504, 507):
            assert status.retryable, code
        elif status.http < 500:
            assert not status.retryable, code


def test_a_failure_that_was_stored_under_a_former_code_is_answered_with_that_of_today():
    for former, today in FORMER_CODES.items():
        assert former not in ErrorCode.__members__
        assert error_of(former, "stored").code is ErrorCode[today]
    with pytest.raises(ValueError, match="NO_SUCH_CODE"):
        error_of("NO_SUCH_CODE", "stored")

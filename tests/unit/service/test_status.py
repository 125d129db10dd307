"""The one error table."""

from __future__ import annotations

import grpc

from revisit.core.errors import ErrorCode
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

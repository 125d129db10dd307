"""Whose work is done where."""

from __future__ import annotations

import contextvars

import structlog

from revisit.service.ports.tracing import RequestContext, current_request, within_request


def test_work_has_the_innermost_origin_and_the_outer_one_afterwards() -> None:
    with within_request(RequestContext("outer")):
        with within_request(RequestContext("inner")):
            assert current_request().request_id == "inner"
        assert current_request().request_id == "outer"
        assert structlog.contextvars.get_contextvars()["request_id"] == "outer"
    assert current_request().request_id is None
    assert "request_id" not in structlog.contextvars.get_contextvars()


def test_a_stream_that_is_given_up_may_be_closed_in_another_context() -> None:
    def stream():
        with within_request(RequestContext("cut")):
            yield current_request().request_id

    answers = stream()
    assert contextvars.copy_context().run(next, answers) == "cut"
    contextvars.copy_context().run(answers.close)
    assert current_request().request_id is None

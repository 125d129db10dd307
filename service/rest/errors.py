"""Errors as RFC 9457 problem+json, all from `service.status.STATUS`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from revisit.core.errors import BadField, ErrorCode, RevisitError
from revisit.service.edge.requests import defect
from revisit.service.status import STATUS, retry_after_s

PROBLEM_JSON = "application/problem+json"
MAX_DETAIL_CHARACTERS = 800
MAX_LISTED_ERRORS = 20


class UnknownPath(RevisitError):
    """No call has this path. Resources are named maps/MAP, maps/MAP/sessions/SESSION and so on; /docs lists calls."""

    code = ErrorCode.NOT_FOUND


class MethodNotAllowed(RevisitError):
    """This path does not take this method."""

    code = ErrorCode.METHOD_NOT_ALLOWED


class ForeignOrigin(RevisitError):
    """A page of another origin may not change anything here."""

    code = ErrorCode.PERMISSION_DENIED


class UnknownHost(RevisitError):
    """The service is not known under this name: REVISIT_ALLOWED_HOSTS lists the names it answers to."""

    code = ErrorCode.PERMISSION_DENIED


REFUSED = "refused"
"""Under this name the state of a request holds the reason of its refusal."""


class ProblemAnswer(Response):
    """An answer that notes in the state of its request why it was refused."""

    media_type = PROBLEM_JSON

    def __init__(self, body: str, status: int, headers: dict[str, str], reason: ErrorCode) -> None:
        """`body` is the JSON of the problem."""
        super().__init__(body, status, headers)
        self._reason = reason

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        scope.setdefault("state", {})[REFUSED] = self._reason
        await super().__call__(scope, receive, send)


def problem(error: RevisitError, request_id: str, headers: dict[str, str] | None = None) -> Response:
    """The problem+json answer to an error, at most 4 KB."""
    status = STATUS[error.code]
    body = {
        "type": f"urn:revisit:error:{error.code.value.lower()}",
        "title": error.code.value.replace("_", " ").capitalize(),
        "status": status.http,
        "detail": _printable(error.message)[:MAX_DETAIL_CHARACTERS],
        "code": status.grpc,
        "reason": error.code.value,
        "retryable": status.retryable,
        "request_id": request_id,
    }
    if error.field is not None:
        body["field"] = _printable(error.field)[:100]
    expected = getattr(error, "expected", None)
    if isinstance(expected, int):
        body["expected_seq"] = expected
    delay_s = retry_after_s(error, status)
    extra = {} if delay_s is None else {"retry-after": str(max(1, math.ceil(delay_s)))}
    if error.code is ErrorCode.UNAUTHENTICATED:
        extra["www-authenticate"] = "Bearer"
    return ProblemAnswer(json.dumps(body), status.http, {**(headers or {}), **extra}, error.code)


def install_error_handlers(app: FastAPI) -> None:
    """Answer every error as a problem, without echoing input."""
    app.add_exception_handler(RevisitError, _on_revisit_error)
    app.add_exception_handler(RequestValidationError, _on_invalid_parameters)
    app.add_exception_handler(HTTPException, _on_http_exception)


def bad_field(errors: Sequence[Any]) -> BadField:
    """pydantic's findings as one error that names the first field and quotes no input."""
    findings = [f"{_location(e['loc'])}: {e['msg']}" for e in errors[:MAX_LISTED_ERRORS]]
    return BadField("; ".join(findings), field=_location(errors[0]["loc"]) if errors else None)


def unexpected(error: Exception, request_id: str) -> Response:
    """The answer to a defect."""
    return problem(defect(error, request_id), request_id)


# Starlette calls each handler with the class it was registered for; its signature says Exception.
async def _on_revisit_error(request: Request, error: Any) -> Response:
    return problem(error, request.state.request_id)


async def _on_invalid_parameters(request: Request, error: Any) -> Response:
    return problem(bad_field(error.errors()), request.state.request_id)


async def _on_http_exception(request: Request, error: Any) -> Response:
    await request.app.state.use_cases.access.delay_refusal(request.client.host if request.client is not None else "")
    known: dict[int, RevisitError] = {404: UnknownPath(), 405: MethodNotAllowed()}
    headers = dict(error.headers or {})
    return problem(known.get(error.status_code, BadField(str(error.detail))), request.state.request_id, headers)


def _location(loc: Sequence[Any]) -> str:
    return ".".join(str(part) for part in loc if part not in ("query", "header", "path", "body"))


def _printable(text: str) -> str:
    """ASCII without control characters, so that no client's bytes reach a log or a terminal as they are."""
    return "".join(c if " " <= c <= "~" else "?" for c in text)

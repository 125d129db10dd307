"""The routes of the calls that are messages in both directions, made from the list of calls."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any

from fastapi import FastAPI, Response

from revisit.api.calls import CALLS, Call, Form
from revisit.service.calls import uses
from revisit.service.domain.callers import current_tenant
from revisit.service.rest.access import served
from revisit.service.rest.answers import answer, answers, status_of
from revisit.service.rest.bodies import describe_json, json_body
from revisit.service.rest.request_form import RequestForm, form_of
from revisit.service.use_cases import UseCases
from revisit.service.wire.fields import Fields
from revisit.service.wire.rendering import rendered

BODY = "body"


def add_routes(app: FastAPI, cases: UseCases) -> None:
    """Add the routes, those of `...:verb` before those that would take the verb for a part of an id.

    To the application itself: the routes of a router that it includes are sought twice for each request.
    """
    calls = [call for call in CALLS.values() if call.row.http and call.row.form is Form.MESSAGE]
    for call in sorted(calls, key=lambda call: ":" not in call.row.http):
        form = form_of(call)
        body = None if form.model is None else describe_json(form.model)
        app.add_api_route(endpoint=_route(form, cases), **_answers(call), **served(call), openapi_extra=body)


def _answers(call: Call) -> dict[str, Any]:
    return {"status_code": 204} if status_of(call) == 204 else answers(call.body, status_of(call))


def _route(form: RequestForm, cases: UseCases) -> Callable[..., Any]:
    """The function of a route, with the parameters of the request as FastAPI reads them from a signature."""
    call, use = form.call, uses.answers(form.call, cases)
    made = partial(_response, call, call.body, status_of(call))

    async def route(**values: Any) -> Response:
        request = form.message(values, values.get(BODY))
        return await rendered(await use(current_tenant(), request), made)

    route.__name__ = call.use
    body = {} if form.model is None else {BODY: Annotated[(form.model, json_body(form.model))]}
    return form.asked_by(**body)(route)


def _response(call: Call, message: Any, status: int, fields: Fields) -> Response:
    if status == 204:
        return Response(status_code=204)
    body = fields[call.row.answer] if call.row.answer else fields
    return answer(message, body, status, replay=fields.get("replay", False))

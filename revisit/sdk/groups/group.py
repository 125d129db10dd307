"""The base of the groups of calls: a call by the name of its RPC."""

from __future__ import annotations

import builtins
from typing import Any, TypeVar

from revisit.api.calls import CALLS
from revisit.sdk.messages import request_of
from revisit.sdk.reading import Resource
from revisit.sdk.transport import Transport, listed

MAX_PAGE = 500
"""The longest page that the service gives, for lists of short items."""


R = TypeVar("R", bound=Resource)


class Group:
    """Calls over one transport. Each raises `revisit.sdk.errors.ApiError`."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def _ask(self, name: str, /, **fields: Any) -> Any:
        """The message that a call answers with; fields that are None are left out."""
        return self._transport.call(name, request_of(CALLS[name].request, fields))

    def _list(self, of: type[R], name: str, /, **fields: Any) -> builtins.list[R]:
        """All resources that a List call answers with, page after page."""
        request = request_of(CALLS[name].request, fields)
        return [of.of(item) for item in listed(self._transport, name, request)]

"""Calls over HTTP that are answered in one piece, on connections that stay open.

`httpx.Client` makes URL, headers, cookies, authentication and redirects anew for each call, a third of the client's
cost of a short call (docs/decisions/0221). The service has none of the last three, so the calls go to the client's own
transport at once; its answers and errors are the same.
"""

from __future__ import annotations

import ssl
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any

import httpx

from revisit.sdk.time_limit import remaining_s

URLS_KEPT = 256

MAX_ANSWER_BYTES = 64 * 2**20
"""Of an answer in one piece, as it is unpacked: a message of gRPC's bound takes no more as JSON."""

MAX_LINE_BYTES = 2**20
"""Of a line of an answer that comes in lines."""


class AnswerTooLarge(Exception):
    """An answer has more bytes than the client takes."""


class HttpCalls:
    """A client of one service. `client` is for answers that come in pieces."""

    def __init__(
        self, base_url: str, timeout: httpx.Timeout, headers: Mapping[str, str], verify: ssl.SSLContext
    ) -> None:
        """`headers` go with every call."""
        # trust_env: a robot's proxy settings must not send its clouds elsewhere.
        self._transport = httpx.HTTPTransport(verify=verify, trust_env=False)
        self.client = httpx.Client(
            base_url=base_url, timeout=timeout, trust_env=False, headers=headers, transport=self._transport
        )
        self._sent_always = self.client.headers
        self._timeout = timeout.as_dict()
        self._url = lru_cache(URLS_KEPT)(self._built_url)

    def request(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, Any] | None = None,
        headers: Mapping[str, str] | None = None,
        content: bytes | None = None,
        json: Any = None,
        most_bytes: int = MAX_ANSWER_BYTES,
    ) -> httpx.Response:
        """The whole answer, of at most so many bytes. Raises httpx.TransportError, AnswerTooLarge."""
        timeout = {of: None if most_s is None else remaining_s(most_s) for of, most_s in self._timeout.items()}
        if self.client.base_url.userinfo:
            # Credentials in the address: authentication is httpx's.
            with self.client.stream(
                method, path, params=params, headers=headers, content=content, json=json,
                timeout=httpx.Timeout(**timeout),
            ) as answer:  # fmt: skip
                return read_whole(answer, most_bytes)
        sent = self._sent_always
        if headers:
            sent = sent.copy()
            sent.update(headers)
        request = httpx.Request(
            method,
            self._url(path),
            params=params or None,
            headers=sent,
            content=content,
            json=json,
            extensions={"timeout": timeout},
        )
        answer = self._transport.handle_request(request)
        answer.request = request
        try:
            return read_whole(answer, most_bytes)
        except BaseException:
            answer.close()
            raise

    def close(self) -> None:
        """Close all connections."""
        self.client.close()

    def _built_url(self, path: str) -> httpx.URL:
        return self.client.build_request("GET", path).url


def read_whole(answer: httpx.Response, most_bytes: int = MAX_ANSWER_BYTES) -> httpx.Response:
    """The answer, read to its end as by `Response.read`. Raises AnswerTooLarge before it is, httpx.TransportError."""
    pieces, size = [], 0
    for piece in answer.iter_bytes():
        pieces.append(piece)
        size += len(piece)
        if size > most_bytes:
            raise AnswerTooLarge(f"the answer has more than {most_bytes} bytes")
    answer._content = b"".join(pieces)  # of which `read` makes the same, without a bound
    return answer


def lines_of(pieces: Iterable[bytes]) -> Iterator[str]:
    """The lines of an answer as they come, without their ends. Raises AnswerTooLarge."""
    rest = b""
    for piece in pieces:
        *whole, rest = (rest + piece).split(b"\n")
        if len(rest) > MAX_LINE_BYTES:
            raise AnswerTooLarge(f"a line of the answer has more than {MAX_LINE_BYTES} bytes")
        yield from (line.rstrip(b"\r").decode(errors="replace") for line in whole)

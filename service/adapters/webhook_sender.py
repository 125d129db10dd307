"""Sending to the URLs that clients chose, without being led where only the service can go.

A name is resolved here, every address of it is judged, and the connection goes to the address that was judged: a name
that leads elsewhere a moment later (DNS rebinding) changes nothing. No proxy and no redirect is followed.
"""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Mapping
from urllib.parse import urlsplit

import httpx

from revisit.service.domain.webhooks import Answered
from revisit.service.features.webhooks.rules import is_public

WHOLE_S = 15.0
"""For resolving, connecting, sending and the head of the answer together; its body is not read."""

USER_AGENT = "Revisit-Webhook/1"


class HttpWebhookSender:
    """`WebhookSender` over HTTP."""

    def __init__(self, *, private_networks: bool = False, trusted: ssl.SSLContext | None = None) -> None:
        """With `private_networks`, any address may be called; `trusted` knows authorities beside the public ones."""
        self._private = private_networks
        self._http = httpx.AsyncClient(
            follow_redirects=False,
            trust_env=False,
            verify=True if trusted is None else trusted,
            timeout=httpx.Timeout(10.0, connect=5.0),
            # A kept connection would go where a name led before.
            limits=httpx.Limits(max_keepalive_connections=0),
        )

    async def send(self, url: str, body: bytes, headers: Mapping[str, str]) -> Answered:
        """See `WebhookSender`."""
        try:
            async with asyncio.timeout(WHOLE_S):
                return await self._send(url, body, headers)
        except TimeoutError:
            return Answered(error=f"no answer within {WHOLE_S:g} s")
        except (httpx.HTTPError, httpx.InvalidURL, OSError, UnicodeError) as error:
            return Answered(error=f"{type(error).__name__}: {error}")

    async def close(self) -> None:
        """See `WebhookSender`."""
        await self._http.aclose()

    async def _send(self, url: str, body: bytes, headers: Mapping[str, str]) -> Answered:
        parts = urlsplit(url)
        host = str(parts.hostname)
        port = parts.port or (443 if parts.scheme == "https" else 80)
        found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
        addresses = [str(entry[4][0]) for entry in found]
        if not self._private and not all(map(is_public, addresses)):
            return Answered(error=f"{host} leads to a private address; REVISIT_WEBHOOK_PRIVATE_NETWORKS allows those")
        target = httpx.URL(url).copy_with(host=addresses[0])
        request = self._http.build_request(
            "POST",
            target,
            content=body,
            headers={**headers, "host": parts.netloc, "user-agent": USER_AGENT},
            extensions={"sni_hostname": host},
        )
        answer = await self._http.send(request, stream=True)
        await answer.aclose()
        return Answered(status=answer.status_code)

"""The head of a request on both transports: its id, its credential, and refusals."""

from __future__ import annotations

import asyncio
import re
import uuid
from collections.abc import Awaitable, Callable, Sequence

import structlog

from revisit.core.errors import RevisitError
from revisit.service.domain.errors import PermissionDenied, TooManyFailures, Unauthenticated
from revisit.service.features.keys.admission import Credential

REQUEST_ID = "x-request-id"
"""The header and the metadata that hold the id of a request."""

_REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,64}", re.ASCII)

_log = structlog.get_logger(__name__)


def request_id_of(sent: object) -> str:
    """The id that a client has sent, or a new one where it is not well formed."""
    return sent if isinstance(sent, str) and _REQUEST_ID.fullmatch(sent) else uuid.uuid4().hex


def defect(error: Exception, request_id: str) -> RevisitError:
    """The answer to an unexpected error: it is logged in full and told in brief."""
    _log.exception("request failed unexpectedly", request_id=request_id, exc_info=error)
    return RevisitError("an internal error occurred; the request id leads to its log entry")


def credential_of(authorization: Sequence[str], address: str, certificate_names: Sequence[str] = ()) -> Credential:
    """The bearer token in the values of all `authorization` headers, with address and names of a certificate.

    Raises Unauthenticated where there is more than one value: proxies and transports differ in which one counts.
    """
    if len(authorization) > 1:
        raise Unauthenticated("send authorization once")
    scheme, _, token = "".join(authorization).partition(" ")
    return Credential(token.strip() if scheme.lower() == "bearer" else None, tuple(certificate_names), address)


async def refusal(verify: Callable[[], Awaitable[object]], every_s: float) -> RevisitError:
    """Verify a credential every so many seconds; the reason, once it has lost its right."""
    while True:
        await asyncio.sleep(every_s)
        try:
            await verify()
        except (Unauthenticated, PermissionDenied, TooManyFailures) as error:
            return error
        except RevisitError:
            # A store that does not answer now is asked again.
            continue

"""Where the service is: one address for both of its sides, HTTP and gRPC."""

from __future__ import annotations

import os
import re
from urllib.parse import urlsplit

from revisit.api.addresses import GRPC_ADDRESS
from revisit.core.errors import BadField
from revisit.sdk.credentials import Credentials
from revisit.sdk.errors import ApiError
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.time_limit import within
from revisit.v1 import system_pb2

HTTP_PORT, GRPC_PORT = 8080, 8090
HERE = f"http://127.0.0.1:{HTTP_PORT}"

ASKED_S = 3.0
"""How long the HTTP side is waited for that tells where gRPC is."""

FORMER = {"REVISIT_URL": "REVISIT_HTTP"}
"""Name of a variable that is gone -> the one in its place."""


def http_address(given: str | None = None) -> str:
    """The URL of the HTTP side: the given one, else $REVISIT_HTTP, else this machine. A host stands for its port 8080.

    Raises BadField where it is no address.
    """
    address = given or _variable("REVISIT_HTTP") or HERE
    if "//" not in address:
        address = f"http://{address}"
        if _parts(address)[1] is None:
            sides = urlsplit(address)
            address = f"http://{sides.netloc}:{HTTP_PORT}{sides.path}"
    _parts(address)
    return address


def grpc_address(given: str | None = None, http: str | None = None, credentials: Credentials | None = None) -> str:
    """The gRPC side, host:port or grpcs://host:port: the given one, else that of the service at `http`; $REVISIT_GRPC,
    else that of the service at $REVISIT_HTTP; else of the one on this machine.

    The service is asked over HTTP, with `credentials`, by default those of the environment. Where it does not say,
    port 8090 is taken beside port 8080. Raises BadField beside another port: it would be a guess; and where the
    service says no address, or one without TLS although it is asked with TLS: the key would be sent there.
    """
    if address := given or ("" if http else _variable("REVISIT_GRPC")):
        return address
    beside = http_address(http)
    host, port, secure = _parts(beside)
    told, why = _told(beside, credentials or Credentials.given())
    if not told and port != HTTP_PORT:
        message = f"the gRPC side of {beside} is not known, as the service does not say it ({why})"
        raise BadField(f"{message}: give --grpc HOST:PORT, or REVISIT_GRPC", field="grpc")
    address = told or f":{GRPC_PORT}"
    address = f"{'grpcs://' if secure else ''}{host}{address}" if address.startswith(":") else address
    if not re.fullmatch(GRPC_ADDRESS, address) or (secure and not address.startswith("grpcs://")):
        message = f"the service at {beside} says that its gRPC side is at {told!r}"
        wrong = "which has no TLS" if re.fullmatch(GRPC_ADDRESS, address) else "which is no address"
        raise BadField(f"{message}, {wrong}: give --grpc HOST:PORT, or REVISIT_GRPC", field="grpc")
    return address


def _told(http: str, credentials: Credentials) -> tuple[str, str]:
    """What the service at a URL says of its gRPC side, "" where it says nothing; and why."""
    from revisit.sdk.rest_transport import RestTransport  # programs that give the address need no HTTP

    transport = RestTransport(http, RetryPolicy(attempts=1), credentials)
    try:
        with within(ASKED_S):
            status = transport.call("GetStatus", system_pb2.GetStatusRequest())
    except ApiError as error:
        return "", error.message
    finally:
        transport.close()
    return status.grpc_address, "it is of an earlier version"


def _parts(url: str) -> tuple[str, int | None, bool]:
    """Host, port and whether it is TLS."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if not host or any(map(str.isspace, url)) or parts.scheme not in ("http", "https"):
        raise BadField(f"{url!r} is no address of a service: it is http://HOST:PORT or HOST", field="http")
    return f"[{host}]" if ":" in host else host, port, parts.scheme == "https"


def _variable(name: str) -> str:
    """A variable of the environment. Raises BadField where its former name alone is set."""
    value = os.environ.get(name, "")
    for former, today in FORMER.items():
        if today == name and not value and os.environ.get(former):
            raise BadField(f"{former} is now {today}", field="http")
    return value

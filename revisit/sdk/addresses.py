"""Where the service is: one address for both of its sides, HTTP and gRPC."""

from __future__ import annotations

import os
from urllib.parse import urlsplit

from revisit.core.errors import BadField

HTTP_PORT, GRPC_PORT = 8080, 8090
HERE = f"http://127.0.0.1:{HTTP_PORT}"

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


def grpc_address(given: str | None = None, http: str | None = None) -> str:
    """The gRPC side, host:port or grpcs://host:port: the given one, else that beside `http`; $REVISIT_GRPC, else that
    beside $REVISIT_HTTP; else this machine.

    Beside port 8080 is port 8090 of the same host. Raises BadField beside another port: it would be a guess.
    """
    if address := given or ("" if http else _variable("REVISIT_GRPC")):
        return address
    beside = http_address(http)
    host, port, secure = _parts(beside)
    if port != HTTP_PORT:
        message = f"the gRPC side of {beside} is not known, as its port is not {HTTP_PORT}: give --grpc HOST:PORT"
        raise BadField(f"{message}, or REVISIT_GRPC", field="grpc")
    return f"{'grpcs://' if secure else ''}{host}:{GRPC_PORT}"


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

"""Notifications to systemd, or another supervisor with NOTIFY_SOCKET (sd_notify(3))."""

from __future__ import annotations

import os
import socket

import structlog

READY = "READY=1"
STOPPING = "STOPPING=1"

log = structlog.get_logger(__name__)


def tell_supervisor(state: str) -> None:
    """Send `state`; nothing where nobody asked for it. The service goes on where it cannot be sent."""
    address = os.environ.get("NOTIFY_SOCKET")
    if not address:
        return
    # An abstract socket begins with a zero byte, which no variable can hold.
    name = "\0" + address[1:] if address.startswith("@") else address
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.settimeout(1.0)
            channel.sendto(state.encode(), name)
    except OSError as error:
        log.warning("supervisor_not_told", state=state, error=str(error))

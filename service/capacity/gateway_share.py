"""The share of one gateway in what a tenant and a client may have of all gateways together."""

from __future__ import annotations


class GatewayShare:
    """One part in as many as there are gateways: no shared counter lies in the way of a request."""

    def __init__(self) -> None:
        """The only gateway, until told otherwise."""
        self.gateways = 1

    def of(self, limit: float) -> float:
        """The part of a rate."""
        return limit / self.gateways

    def of_whole(self, limit: int) -> int:
        """The part of a number, at least one."""
        return max(1, -(-limit // self.gateways))

"""The form of a gRPC address, as the operator writes it and a client takes it from a service."""

from __future__ import annotations

GRPC_ADDRESS = r"(grpcs://)?(\[[0-9A-Fa-f:.]+\]|[^/\s:@\[\]]+):[0-9]{1,5}"
"""HOST:PORT, or grpcs://HOST:PORT for TLS."""

"""Revisit's Python SDK: `from revisit import Client`.

    client = Client()                                # REST on http://127.0.0.1:8080
    client = Client.grpc("127.0.0.1:8090")           # the same calls over gRPC
    client = AsyncClient()                           # the same calls, each awaited
    PointCloud(points, {"ring": ring})               # points with columns, wherever points are taken
    with within(2.0): ...                            # calls that take 2 s together at most
    picture(client, "town")                          # shown in a notebook

Errors are `revisit.sdk.errors.ApiError`; transforms are (4, 4) matrices named T_target_source; lengths are metres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from revisit.sdk.async_client import AsyncClient as AsyncClient
    from revisit.sdk.client import Client as Client
    from revisit.sdk.clouds import Cloud as Cloud
    from revisit.sdk.clouds import PointCloud as PointCloud
    from revisit.sdk.errors import ApiError as ApiError
    from revisit.sdk.input_watch import SuspiciousInput as SuspiciousInput
    from revisit.sdk.picture import MapPicture as MapPicture
    from revisit.sdk.picture import picture as picture
    from revisit.sdk.tables import to_dataframe as to_dataframe
    from revisit.sdk.time_limit import within as within

__all__ = [
    "ApiError", "AsyncClient", "Client", "Cloud", "MapPicture", "PointCloud", "SuspiciousInput", "picture",
    "to_dataframe", "within",
]  # fmt: skip

_HOMES = {
    "ApiError": "revisit.sdk.errors",
    "AsyncClient": "revisit.sdk.async_client",
    "Client": "revisit.sdk.client",
    "Cloud": "revisit.sdk.clouds",
    "MapPicture": "revisit.sdk.picture",
    "PointCloud": "revisit.sdk.clouds",
    "SuspiciousInput": "revisit.sdk.input_watch",
    "picture": "revisit.sdk.picture",
    "to_dataframe": "revisit.sdk.tables",
    "within": "revisit.sdk.time_limit",
}


def __getattr__(name: str) -> Any:
    # On first use: the service imports `revisit.v1` and needs none of the SDK, and `revisit --help` must be quick.
    if name not in _HOMES:
        raise AttributeError(f"module 'revisit' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)

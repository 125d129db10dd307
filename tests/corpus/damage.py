"""The files of the corpus damaged: cut short or with flipped bits, and the readers that they meet in the service."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from revisit.api.calls import CALLS
from revisit.formats import decode_content
from revisit.service.calls.ingest import submap_to_post
from revisit.service.domain.limits import SUBMAP_POINTS
from revisit.service.features.ingest.clouds import EncodedCloud, accept_cloud
from revisit.service.grpc.errors import _parse
from revisit.service.rest.bodies import parse_json
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.request_form import form_of
from revisit.v1 import submap_pb2
from tests.corpus.rows import CloudToSend, cases
from tests.corpus.sending import cloud_message, transform
from tests.corpus.write import body_of

HEADER_BYTES = 600
"""Where most flips strike: a flip in the middle of the points only moves a point."""


@dataclass(frozen=True)
class Sound:
    """Bytes as a row sends them, with what the service reads them with; `cloud` where they are one."""

    name: str
    data: bytes
    read: Callable[[bytes], object]
    cloud: CloudToSend | None = None


def cuts(data: bytes, count: int) -> Iterator[bytes]:
    """`data` up to each of `count` places, the first of which is its beginning."""
    return (data[: len(data) * place // count] for place in range(count))


def flips(data: bytes, count: int, rng: random.Random) -> Iterator[bytes]:
    """`data` with one flipped bit, or now and then eight, `count` times."""
    for _ in range(count if data else 0):
        changed = bytearray(data)
        for _ in range(rng.choice((1, 1, 1, 8))):
            reach = min(len(data), HEADER_BYTES) if rng.random() < 0.7 else len(data)
            changed[rng.randrange(reach)] ^= 1 << rng.randrange(8)
        yield bytes(changed)


def sound_files() -> list[Sound]:
    """Every cloud of the corpus under every media type it is sent with, alone and in a message, and every JSON body."""
    clouds = {(cloud.body, cloud.type, cloud.encoding): cloud for case in cases() for cloud in case.clouds}
    bodies = {entry["body"] for case in cases() for entry in case.rest if entry.get("body", "").endswith(".json")}
    return [
        *(Sound(f"{cloud.body} as {cloud.type}", cloud.data, _cloud_reader(cloud), cloud) for cloud in clouds.values()),
        *(Sound(f"{name} in a message", _message(name), _read_message) for name in body_names_of_good_clouds()),
        *(Sound(body, body_of(body), _read_json) for body in sorted(bodies)),
    ]


def body_names_of_good_clouds() -> list[str]:
    """One good file of each format."""
    return sorted({cloud.body for case in cases() for cloud in case.clouds if cloud.body.startswith("G05-")})


def _cloud_reader(cloud: CloudToSend) -> Callable[[bytes], object]:
    return lambda data: accept_cloud(
        EncodedCloud(decode_content(data, cloud.encoding), cloud.type), max_points=SUBMAP_POINTS
    )


def _message(body: str) -> bytes:
    cloud = CloudToSend.read(body)
    request = submap_pb2.PostSubmapRequest(
        parent="maps/m/sessions/s", submap_id="a", t_odom_submap=transform(cloud.pose), cloud=cloud_message(cloud)
    )
    return request.SerializeToString()


def _read_message(data: bytes) -> object:
    command = submap_to_post(_parse(submap_pb2.PostSubmapRequest.FromString, data))
    return accept_cloud(command.cloud, max_points=SUBMAP_POINTS)


def _read_json(data: bytes) -> object:
    return parse_json(data, form_of(CALLS["CreateMap"]).model, HttpLimits())

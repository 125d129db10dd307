"""JSON of requests, and of problems. Requests are strict, and their bounds are those of `contract.limits`.

Answers are no schemas of their own: they are the messages of `proto/revisit/v1` (see `service.wire`).
"""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from revisit.service.application.catalogue.maps import CreateMap
from revisit.service.application.catalogue.robots import CreateRobot
from revisit.service.application.catalogue.sessions import CreateSession
from revisit.service.application.contract import limits
from revisit.service.application.contract.limits import Range
from revisit.service.application.contract.loop_policy import LoopPolicy
from revisit.service.application.contract.states import EventKind
from revisit.service.application.push.webhooks import CreateWebhook
from revisit.service.application.query.freshness import DEFAULT_WAIT_S
from revisit.service.application.query.search_answers import SearchCriteria


def bounds(of: Range) -> dict[str, Any]:
    """A range as the arguments of a pydantic or FastAPI field, finite."""
    return {"gt" if of.above else "ge": of.least, "le": of.most, "allow_inf_nan": False}


def _in_digits(value: Any) -> Any:
    """`value` as it was sent; raises ValueError for 1_000, 1.0 and other spellings that Python would take."""
    if isinstance(value, str) and not re.fullmatch(r"-?[0-9]{1,20}", value, re.ASCII):
        raise ValueError("must be an integer, in digits alone")
    return value


IN_DIGITS = BeforeValidator(_in_digits)
"""Of an integer of a query string."""

STOREY_LENGTH: dict[str, Any] = {"min_length": 1, "max_length": limits.STOREY_CHARACTERS}
Id = Annotated[str, Field(pattern=f"^{limits.ID_PATTERN}$", examples=["yard-3"])]
DisplayName = Annotated[str, Field(max_length=limits.DISPLAY_NAME_CHARACTERS, pattern=r"^[^\x00-\x1f\x7f]*$")]
Storey = Annotated[str, Field(**STOREY_LENGTH, examples=["B2"])]
_DESCRIPTOR_LENGTH: dict[str, Any] = {
    "min_length": int(limits.DESCRIPTOR_LENGTH.least),
    "max_length": int(limits.DESCRIPTOR_LENGTH.most),
    # The first bad number is reported, not each of thousands.
    "fail_fast": True,
}
Coordinate = Annotated[float, Field(**bounds(limits.PRIOR_COORDINATE_M))]
_DISTANCE_POINTS: dict[str, Any] = {
    "min_length": 3 * int(limits.DISTANCE_POINTS.least),
    "max_length": 3 * int(limits.DISTANCE_POINTS.most),
    "fail_fast": True,
}


class Request(BaseModel):
    """What a client sends: nothing unknown, nothing coerced, nothing infinite."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    most_bytes: ClassVar[int] = 16 * 2**10
    """Of the body: several times what its fields take at most."""


class LoopPolicyRequest(Request):
    """What a map overrides of the service's rules for loop closures; what is not given is as the service has it.

    `candidates`: submaps that are verified for each new one. A candidate is accepted with a score of at least
    `min_score` and an overlap of at least `min_overlap`, where at most `max_seen_through` of it was looked through.
    """

    candidates: Annotated[int, Field(**bounds(limits.LOOP_CANDIDATES))] | None = None
    min_score: Annotated[float, Field(**bounds(limits.MIN_SCORE))] | None = None
    min_overlap: Annotated[float, Field(**bounds(limits.MIN_OVERLAP))] | None = None
    max_seen_through: Annotated[float, Field(**bounds(limits.MAX_SEEN_THROUGH))] | None = None


class CreateMapRequest(Request):
    """A new map; `tau_m`, `stride_m`, `leave_distance_m` and `loop_policy` override the service's settings where given.

    `scene_scale` is the size of its scene compared with a street, e.g. 0.25 for rooms; it cannot be changed later.
    """

    map_id: Id
    display_name: DisplayName = ""
    tau_m: Annotated[float, Field(**bounds(limits.TAU_M))] | None = None
    stride_m: Annotated[float, Field(**bounds(limits.STRIDE_M))] | None = None
    leave_distance_m: Annotated[float, Field(**bounds(limits.LEAVE_DISTANCE_M))] | None = None
    scene_scale: Annotated[float, Field(**bounds(limits.SCENE_SCALE))] = 1.0
    loop_policy: LoopPolicyRequest = LoopPolicyRequest()

    def command(self) -> CreateMap:
        """What the use case takes."""
        own = self.model_dump(exclude={"loop_policy"})
        return CreateMap(**own, loop_policy=LoopPolicy(**self.loop_policy.model_dump()))


class CreateRobotRequest(Request):
    """A new robot."""

    robot_id: Id
    display_name: DisplayName = ""

    def command(self) -> CreateRobot:
        """What the use case takes."""
        return CreateRobot(self.robot_id, self.display_name)


class CreateWebhookRequest(Request):
    """A new webhook; `map_id` names an existing map, whose events it gets alone."""

    webhook_id: Id
    url: str = Field(max_length=limits.URL_CHARACTERS)
    map_id: Id | None = None
    kinds: list[Annotated[EventKind, Field(strict=False)]] = Field(default=[], max_length=len(EventKind))

    def command(self) -> CreateWebhook:
        """What the use case takes."""
        return CreateWebhook(self.webhook_id, self.url, self.map_id, tuple(self.kinds))


class CreateSessionRequest(Request):
    """A new session; `robot_id` names an existing robot.

    `storey` is the storey (level, floor) of a building that all of the session is driven on, in your words. Submaps on
    storeys of different names are never compared; without it, they are compared with all.
    """

    session_id: Id
    robot_id: Id | None = None
    storey: Storey | None = None

    def command(self, map_id: str) -> CreateSession:
        """What the use case takes."""
        return CreateSession(map_id, self.session_id, self.robot_id, self.storey)


class RevertMapRequest(Request):
    """Which version of the map comes back."""

    version: Annotated[int, Field(**bounds(limits.MAP_VERSION))]


class MergeMapRequest(Request):
    """What is merged into a map: `source`, another map or a session of it, by resource name.

    `validate_only` only tells what would happen. `T_map_source` as x,y,z,qx,qy,qz,qw (metres, unit quaternion) is
    roughly where the frame of the source lies in that of the map, `radius_m` how far from there loops may lead.
    """

    source: Annotated[str, Field(max_length=limits.RESOURCE_NAME_CHARACTERS)]
    validate_only: bool = False
    T_map_source: Annotated[str, Field(max_length=400)] | None = None
    radius_m: Annotated[float, Field(**bounds(limits.RADIUS_M))] | None = None


class MeasureMapDistancesRequest(Request):
    """Points as x, y, z of one after the other, metres, in a frame of a version of a map.

    `frame` may be left out where the version has one alone.
    """

    most_bytes: ClassVar[int] = 128 * 2**10
    """A thousand points, written with all digits."""

    points_m: Annotated[list[Coordinate], Field(**_DISTANCE_POINTS)]
    frame: Annotated[str, Field(max_length=limits.ID_CHARACTERS)] = ""


class PublishMapFileRequest(Request):
    """What the map is, in an operator's words."""

    map_descriptor: Annotated[str, Field(max_length=limits.NOTE_CHARACTERS)] = ""


Note = Annotated[str, Field(max_length=limits.NOTE_CHARACTERS)]
Name = Annotated[str, Field(max_length=limits.RESOURCE_NAME_CHARACTERS)]


class DecisionRequest(Request):
    """Why somebody decides on a loop closure, in their own words."""

    note: Note = ""


class CreateLoopClosureRequest(Request):
    """A loop closure that a person has found between two described submaps, `query` and `match`, by resource name.

    `T_match_query` as x,y,z,qx,qy,qz,qw (metres, unit quaternion) is roughly how the two lie to each other: where
    registration starts.
    """

    query: Name
    match: Name
    T_match_query: Annotated[str, Field(max_length=400)] | None = None
    note: Note = ""


class SearchRequest(Request):
    """Search by `submap` (a resource name) or by `descriptor` with its `model_version`; exactly one of the two.

    `min_seq`, the seq of a submap: the answer rests on every submap of the map up to it, or is a 504 (SEQ_NOT_REACHED)
    after `min_seq_timeout_s` seconds. A submap whose description failed is not waited for.

    `storey`, with a descriptor: where it was taken; submaps of sessions on another storey are no hits. A submap is on
    that of its session.
    """

    most_bytes: ClassVar[int] = 128 * 2**10
    """The longest descriptor takes 100,000 bytes, written with all digits."""

    submap: Annotated[str, Field(max_length=limits.RESOURCE_NAME_CHARACTERS)] | None = None
    descriptor: Annotated[list[float], Field(**_DESCRIPTOR_LENGTH)] | None = None
    model_version: Annotated[str, Field(max_length=limits.MODEL_VERSION_CHARACTERS)] | None = None
    k: Annotated[int, Field(**bounds(limits.K))] = SearchCriteria().k
    min_similarity: Annotated[float, Field(**bounds(limits.MIN_SIMILARITY))] | None = None
    exclude_session: Id | None = None
    only_session: Id | None = None
    leave_distance_m: Annotated[float, Field(**bounds(limits.LEAVE_DISTANCE_M))] | None = None
    prior_position_m: Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None = None
    radius_m: Annotated[float, Field(**bounds(limits.RADIUS_M))] | None = None
    storey: Storey | None = None
    min_seq: Annotated[int, Field(**bounds(limits.MIN_SEQ))] = 0
    min_seq_timeout_s: Annotated[float, Field(**bounds(limits.WAIT_S))] = DEFAULT_WAIT_S

    def criteria(self) -> SearchCriteria:
        """What hits must satisfy."""
        position = self.prior_position_m
        return SearchCriteria(
            k=self.k,
            min_similarity=self.min_similarity,
            exclude_session=self.exclude_session,
            only_session=self.only_session,
            leave_distance_m=self.leave_distance_m,
            prior_position_m=None if position is None else (position[0], position[1], position[2]),
            radius_m=self.radius_m,
            storey=self.storey,
        )


class Problem(BaseModel):
    """RFC 9457 problem details; `reason` is the machine-readable cause, `code` its canonical gRPC code."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    reason: str
    retryable: bool
    request_id: str
    field: str | None = None
    expected_seq: int | None = None

"""JSON of requests, and of problems. Requests are strict, and their bounds are those of `contract.limits`.

The models of most requests are made from their messages (`request_form`).

Answers are no schemas of their own: they are the messages of `proto/revisit/v1` (see `service.wire`).
"""

from __future__ import annotations

import re
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from revisit.core.config import Profile
from revisit.service.domain import limits
from revisit.service.domain.limits import Range
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.waiting.freshness import DEFAULT_WAIT_S


def bounds(of: Range) -> dict[str, Any]:
    """A range as the arguments of a pydantic or FastAPI field, finite."""
    return {"gt" if of.above else "ge": of.least, "le": of.most, "allow_inf_nan": False}


def length(of: Range, each: int = 1) -> dict[str, Any]:
    """The lengths of a list of numbers, `each` for one item, as the arguments of a pydantic field."""
    # The first bad number is reported, not each of thousands.
    return {"min_length": each * int(of.least), "max_length": each * int(of.most), "fail_fast": True}


def _in_digits(value: Any) -> Any:
    """`value` as it was sent; raises ValueError for 1_000, 1.0 and other spellings that Python would take."""
    if isinstance(value, str) and not re.fullmatch(r"-?[0-9]{1,20}", value, re.ASCII):
        raise ValueError("must be an integer, in digits alone")
    return value


IN_DIGITS = BeforeValidator(_in_digits)
"""Of an integer of a query string."""

ID: dict[str, Any] = {"pattern": f"^{limits.ID_PATTERN}$", "examples": ["yard-3"]}
DISPLAY_NAME: dict[str, Any] = {"max_length": limits.DISPLAY_NAME_CHARACTERS, "pattern": r"^[^\x00-\x1f\x7f]*$"}
PROFILE: dict[str, Any] = {"pattern": f"^({'|'.join(Profile)})$"}
STOREY: dict[str, Any] = {"min_length": 1, "max_length": limits.STOREY_CHARACTERS, "examples": ["B2"]}
TAG: dict[str, Any] = {"min_length": 1, "max_length": limits.TAG_CHARACTERS, "examples": ["tag36h11:17"]}

Id = Annotated[str, Field(**ID)]
Storey = Annotated[str, Field(**STOREY)]
Coordinate = Annotated[float, Field(**bounds(limits.PRIOR_COORDINATE_M))]


class Request(BaseModel):
    """A client's input: nothing unknown, nothing coerced, nothing infinite."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    most_bytes: ClassVar[int] = 16 * 2**10
    """Of the body: several times the most that its fields take."""


class SearchRequest(Request):
    """Search by `submap` (a resource name) or by `descriptor` with its `model_version`; exactly one of the two.

    `min_seq`, the seq of a submap: the answer rests on every submap of the map up to it, or is a 504 (SEQ_NOT_REACHED)
    after `min_seq_timeout_s` seconds. A submap that failed is not waited for.

    `storey`, with a descriptor: where it was taken; submaps of sessions on another storey are no hits. A submap is on
    that of its session.
    """

    most_bytes: ClassVar[int] = 256 * 2**10
    """The longest descriptor takes 100,000 bytes, written with all digits."""

    submap: Annotated[str, Field(max_length=limits.RESOURCE_NAME_CHARACTERS)] | None = None
    descriptor: Annotated[list[float], Field(**length(limits.DESCRIPTOR_LENGTH))] | None = None
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
        """Conditions of hits."""
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

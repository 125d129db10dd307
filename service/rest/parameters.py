"""Dependencies of routes by type: the use cases, the tenant, pages, poses, keys, search criteria."""

from __future__ import annotations

from typing import Annotated, TypeAlias

from fastapi import Depends, Header, Path, Query
from starlette.requests import Request

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.service.domain import limits
from revisit.service.domain.callers import current_tenant
from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.features.waiting.freshness import DEFAULT_WAIT_S, Freshness
from revisit.service.rest.bodies import cloud_body, parse_numbers
from revisit.service.rest.schemas import IN_DIGITS, STOREY, bounds
from revisit.service.use_cases import UseCases

POSE_HELP = "x,y,z,qx,qy,qz,qw: translation in metres and unit quaternion."

POINT_HELP = "x,y,z in metres"

LEVEL_HELP = (
    "x,y,z,qx,qy,qz,qw: the pose of a cloud in a frame whose z points up, of which the rotation counts. Without it, "
    "z of the cloud itself must point up."
)

MIN_SEQ_HELP = (
    "The seq of a submap: the answer rests on every submap of the map up to it, or is a 504 (SEQ_NOT_REACHED)."
)


STOREY_HELP = "The storey that the cloud was taken on: submaps of sessions on another one are not compared."


async def _use_cases(request: Request) -> UseCases:
    use_cases: UseCases = request.app.state.use_cases
    return use_cases


async def _tenant() -> TenantId:
    # From the credential alone: `access.admitted` has verified it before.
    return current_tenant()


PATH_ID_CHARACTERS = 200
"""Characters of an id in a path, which may be no id."""

Id: TypeAlias = Annotated[str, Path(max_length=PATH_ID_CHARACTERS)]
Cases: TypeAlias = Annotated[UseCases, Depends(_use_cases)]
Tenant: TypeAlias = Annotated[TenantId, Depends(_tenant)]


async def _admitted_cloud(request: Request, cases: Cases, tenant: Tenant) -> EncodedCloud:
    """The body as a cloud; one that will be refused is not even read."""
    cases.admission.precheck_cloud(tenant)
    return await cloud_body(request)


Cloud: TypeAlias = Annotated[EncodedCloud, Depends(_admitted_cloud)]


async def _session_key(map_id: Id, session_id: Id) -> SessionKey:
    return SessionKey(map_id, session_id)


async def _submap_key(map_id: Id, session_id: Id, submap_id: Id) -> SubmapKey:
    return SubmapKey(map_id, session_id, submap_id)


SessionOf: TypeAlias = Annotated[SessionKey, Depends(_session_key)]
SubmapOf: TypeAlias = Annotated[SubmapKey, Depends(_submap_key)]
StampNs: TypeAlias = Annotated[int, Query(**bounds(limits.STAMP_NS)), IN_DIGITS]


def pose(text: str, field: str) -> Matrix4:
    """The (4, 4) transform of `x,y,z,qx,qy,qz,qw`. Raises BadField or BadTransform."""
    numbers = parse_numbers(text, 7, field, "x,y,z,qx,qy,qz,qw")
    return se3.from_quaternion(numbers[3:], numbers[:3])


async def _pose_of_submap(
    T_odom_submap: Annotated[str | None, Query(description=POSE_HELP, max_length=400)] = None,
    header: Annotated[str | None, Header(alias="T-Odom-Submap", description=POSE_HELP)] = None,
) -> Matrix4:
    return pose(_given(T_odom_submap, header, "T_odom_submap"), "T_odom_submap")


async def _pose_of_sensor(
    T_odom_sensor: Annotated[str | None, Query(description=POSE_HELP, max_length=400)] = None,
    header: Annotated[str | None, Header(alias="T-Odom-Sensor", description=POSE_HELP)] = None,
) -> Matrix4:
    return pose(_given(T_odom_sensor, header, "T_odom_sensor"), "T_odom_sensor")


def _given(query: str | None, header: str | None, field: str) -> str:
    if (query is None) == (header is None):
        raise BadField(f"give {field} once, as query parameter or as header", field=field)
    return query or header or ""


PoseOfSubmap: TypeAlias = Annotated[Matrix4, Depends(_pose_of_submap)]
PoseOfSensor: TypeAlias = Annotated[Matrix4, Depends(_pose_of_sensor)]


async def prior_position(
    prior_position_m: Annotated[str | None, Query(description=POINT_HELP, max_length=200)] = None,
) -> tuple[float, float, float] | None:
    """The prior of a search by cloud. Raises BadField."""
    if prior_position_m is None:
        return None
    x, y, z = parse_numbers(prior_position_m, 3, "prior_position_m", "x,y,z")
    return (x, y, z)


Prior: TypeAlias = Annotated[tuple[float, float, float] | None, Depends(prior_position)]
RadiusM: TypeAlias = Annotated[float | None, Query(**bounds(limits.RADIUS_M))]


async def level_pose(
    T_level_query: Annotated[str | None, Query(description=LEVEL_HELP, max_length=400)] = None,
) -> Matrix4 | None:
    """Which way is up in a cloud that asks. Raises BadField, BadTransform."""
    return None if T_level_query is None else pose(T_level_query, "T_level_query")


LevelPose: TypeAlias = Annotated[Matrix4 | None, Depends(level_pose)]
SessionId: TypeAlias = Annotated[str | None, Query(max_length=limits.ID_CHARACTERS)]


StoreyName: TypeAlias = Annotated[str | None, Query(description=STOREY_HELP, **STOREY)]


async def criteria_of_query(
    prior: Prior,
    k: Annotated[int, Query(**bounds(limits.K)), IN_DIGITS] = SearchCriteria().k,
    min_similarity: Annotated[float | None, Query(**bounds(limits.MIN_SIMILARITY))] = None,
    exclude_session: SessionId = None,
    only_session: SessionId = None,
    radius_m: RadiusM = None,
    storey: StoreyName = None,
) -> SearchCriteria:
    """The criteria of a search by cloud, from the query string."""
    return SearchCriteria(k, min_similarity, exclude_session, only_session, None, prior, radius_m, storey)


async def freshness_of_query(
    min_seq: Annotated[int, Query(**bounds(limits.MIN_SEQ), description=MIN_SEQ_HELP), IN_DIGITS] = 0,
    min_seq_timeout_s: Annotated[float, Query(**bounds(limits.WAIT_S))] = DEFAULT_WAIT_S,
) -> Freshness:
    """The read barrier, from the query string."""
    return Freshness(min_seq, min_seq_timeout_s)


Fresh: TypeAlias = Annotated[Freshness, Depends(freshness_of_query)]

"""Maps, robots, sessions and submaps."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import fields

from revisit.service.domain.identity import TenantId
from revisit.service.domain.loop_policy import LoopPolicy
from revisit.service.domain.records import RobotRecord, SessionDetails
from revisit.service.features.catalogue.maps import CreateMap, MapView
from revisit.service.features.catalogue.robots import CreateRobot
from revisit.service.features.catalogue.sessions import CreateSession, SessionView
from revisit.service.features.resources.views import SubmapView
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, failure_fields, fields_in_map, fields_of, geodetic_fields, resource_name
from revisit.service.wire.rendering import Answer
from revisit.v1 import map_pb2, robot_pb2, session_pb2, submap_pb2


async def create_map(cases: UseCases, tenant: TenantId, request: map_pb2.CreateMapRequest) -> Answer:
    """Absent fields are as the service is configured."""
    own = requests.present(request, "tau_m", "stride_m", "leave_distance_m", "scene_scale")
    policy = LoopPolicy(**requests.present(request.loop_policy, *(field.name for field in fields(LoopPolicy))))
    profile = request.profile or CreateMap.profile
    command = CreateMap(request.map_id, request.display_name, **own, loop_policy=policy, profile=profile)
    created = await cases.maps.create(tenant, command)
    return {"map": map_fields(created.map), "replay": created.replay}


async def create_robot(cases: UseCases, tenant: TenantId, request: robot_pb2.CreateRobotRequest) -> Answer:
    """A new robot."""
    created = await cases.robots.create(tenant, CreateRobot(request.robot_id, request.display_name))
    return {"robot": robot_fields(created.robot), "replay": created.replay}


async def create_session(cases: UseCases, tenant: TenantId, request: session_pb2.CreateSessionRequest) -> Answer:
    """A new session."""
    robot_id = names.robot_id(request.robot, "robot") if request.robot else None
    map_id = names.map_id(request.parent, "parent")
    details = {name: value or None for name, value in SessionDetails.of(request).items()}
    command = CreateSession(map_id, request.session_id, robot_id, **details)
    created = await cases.sessions.create(tenant, command)
    return {"session": session_fields(created.session), "replay": created.replay}


async def get_submap(cases: UseCases, tenant: TenantId, request: submap_pb2.GetSubmapRequest) -> Answer:
    """A submap."""
    full = request.view == submap_pb2.GetSubmapRequest.FULL
    return {"submap": submap_fields(await cases.submaps.get(tenant, names.submap_key(request.name), full=full))}


async def download_submap(
    cases: UseCases, tenant: TenantId, request: submap_pb2.DownloadSubmapRequest
) -> AsyncIterator[Fields]:
    """A file in chunks; the first one has its type."""
    key, what = names.submap_key(request.name), requests.download(request.format)
    with cases.budget.hold(tenant) as held:
        file = await cases.submaps.download(tenant, key, *what, room=held.wait_for)
        held.set(len(file.data))
        for chunk in requests.chunks(file):
            yield chunk


def map_fields(view: MapView) -> Fields:
    """The fields of a Map."""
    origin = None if view.origin is None else geodetic_fields(view.origin)
    return fields_of(map_pb2.Map, view, name=f"maps/{view.map_id}", origin=origin)


def robot_fields(record: RobotRecord) -> Fields:
    """The fields of a Robot."""
    return fields_of(robot_pb2.Robot, record, name=f"robots/{record.robot_id}")


def session_fields(view: SessionView) -> Fields:
    """The fields of a Session."""
    return fields_of(session_pb2.Session, view, name=view.key.name, robot=resource_name("robots", view.robot_id))


def submap_fields(view: SubmapView) -> Fields:
    """The fields of a Submap."""
    return fields_of(
        submap_pb2.Submap,
        view,
        name=view.key.name,
        seq=view.seq,
        raw_bytes=12 * view.point_count,
        failure=failure_fields(view),
        operation=f"operations/{view.operation_id}",
        place_descriptor=None if view.place_descriptor is None else view.place_descriptor.tolist(),
        **fields_in_map("t_map_submap", view.in_map),
    )

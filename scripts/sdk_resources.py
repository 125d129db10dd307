"""The resources of the SDK: a frozen dataclass of each message of `proto/revisit/v1`, with its comments."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import cast

from google.protobuf.descriptor import Descriptor, FieldDescriptor

from revisit.api.http_form import spelling
from revisit.sdk import own_resources
from revisit.v1 import (
    anchor_pb2,
    event_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    mapping_pb2,
    operation_pb2,
    plan_pb2,
    retention_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    webhook_pb2,
)
from revisit.v1.comments import COMMENTS

PATH = "revisit/sdk/resources.py"

MADE = (
    anchor_pb2.GeodeticPosition, anchor_pb2.Anchor, anchor_pb2.AnchoredSession, anchor_pb2.Georeference,
    map_pb2.LoopPolicy, map_pb2.Map, retention_pb2.RetentionPolicy, retention_pb2.RetentionOutcome,
    retention_pb2.RetentionReport, retention_pb2.MapRetention,
    robot_pb2.Robot, session_pb2.OdometryFault, session_pb2.Finding, session_pb2.NoLoops, session_pb2.Session,
    operation_pb2.Failure, submap_pb2.Submap, loop_closure_pb2.SearchHit, loop_closure_pb2.LocalizedCandidate,
    loop_closure_pb2.LocalizeResponse,
    loop_closure_pb2.RelocalisedPose, loop_closure_pb2.RelocaliseDrive, loop_closure_pb2.RelocaliseAnswer,
    loop_closure_pb2.LoopClosure, loop_closure_pb2.LoopClosureEvent, mapping_pb2.MapChange, mapping_pb2.MapMerge,
    mapping_pb2.RefusedJoin, mapping_pb2.MapVersionSummary, mapping_pb2.MapVersion, mapping_pb2.SubmapPose,
    mapping_pb2.Correction, mapping_pb2.DriveChanges, map_file_pb2.MapFile, plan_pb2.PlanPin, plan_pb2.Plan,
    event_pb2.Event, webhook_pb2.WebhookDelivery,
)  # fmt: skip
"""Messages that become resources field by field. All others are written by hand in `revisit.sdk.own_resources`."""

NAMES = {
    "LocalizedCandidate": "Candidate",
    "LocalizeResponse": "Localization",
    "RelocaliseAnswer": "Relocalisation",
    "RelocaliseDrive": "TellingDrive",
    "place_descriptor": "descriptor",
}
"""Messages and fields with another name in the SDK."""

NONE = {
    "Anchor.state", "Anchor.reason", "Plan.storey",
    "Session.robot", "Session.storey", "Session.drift", "Submap.model_version", "LocalizedCandidate.reason",
    "LocalizeResponse.session",
    "LoopClosure.reason", "LoopClosure.graph_state", "LoopClosureEvent.reason", "LoopClosureEvent.graph_state",
    "LoopClosureEvent.map_version", "MapVersion.restored_from", "MapVersion.operation", "WebhookDelivery.status",
    "WebhookDelivery.error", "RelocalisedPose.session", "RelocaliseAnswer.reason",
}  # fmt: skip
"""Fields that are never absent, and None where they are empty, zero or unspecified."""

ALWAYS = {
    "Map.loop_policy", "MapRetention.policy",
    "Anchor.t_odom_sensor", "Georeference.t_enu_map",
    "Submap.t_odom_submap", "MapVersion.summary", "SubmapPose.t_map_submap", "Correction.t_map_odom",
}  # fmt: skip
"""Messages and transforms that are never absent."""

POINTS = {"Anchor.local_m", "Anchor.residual_m", "MapChange.moved_from_m"}
"""Points that may be absent; all others, and JSON, never are."""

NOT_COMPARED = {"MapMerge.report"}

MEANT = {
    "in_map": "The pose in a frame of the map; None while no version of the map has the session.",
    "covariance": "(6, 6) of (x, y, z, rx, ry, rz), metres and radians; NaN where the graph does not tell it.",
}
"""Comments of fields that are not those of the messages."""

HEAD = '''"""Answers of the service as frozen dataclasses. Generated from proto/revisit/v1 by `make proto`; do not edit.

Optional fields are None where the service says nothing, also those that are empty or 0 in the interface.
"""

from __future__ import annotations

from dataclasses import dataclass, field

'''
_PLACED = {"frame", "map_version"}
_KNOWN = {"Transform": "Matrix4", "Vector3": "tuple[float, float, float]", "Struct": "Json"}
_SCALARS = {
    FieldDescriptor.CPPTYPE_BOOL: "bool",
    FieldDescriptor.CPPTYPE_STRING: "str",
    FieldDescriptor.CPPTYPE_DOUBLE: "float",
    FieldDescriptor.CPPTYPE_FLOAT: "float",
}


def module() -> str:
    """The text of the module."""
    own = sorted(name for name, one in vars(own_resources).items() if isinstance(one, type) and _is_own(one))
    imports = "".join(f"from revisit.sdk.own_resources import {name} as {name}\n" for name in own)
    imports += "from revisit.sdk.own_resources import in_map\n"
    imports += "from revisit.sdk.reading import Json, Matrix4, Resource, covariance_of, read_by\n"
    made = (_resource(cast(Descriptor, one.DESCRIPTOR)) for one in MADE)
    return HEAD + imports + "".join(f"\n\n{text}" for text in made)


def _is_own(kind: type) -> bool:
    return kind.__module__ == own_resources.__name__


def _resource(of: Descriptor) -> str:
    placed = _pose_in_map(of)
    left_out = _PLACED if placed else set()
    lines = [text for one in of.fields if one.name not in left_out for text in _field(one, placed)]
    head = ["@dataclass(frozen=True, kw_only=True)", f"class {_name(of.name)}(Resource):"]
    return "\n".join([*head, *_comment(COMMENTS[of.full_name]), "", *lines]) + "\n"


def _pose_in_map(of: Descriptor) -> str:
    """The transform that with its frame and version is `in_map`; "" where there is none."""
    names = {one.name for one in of.fields}
    placed = sorted(names & {"t_map_submap", "t_map_query", "t_map_sensor"})
    return placed[0] if placed and names >= _PLACED else ""


def _field(of: FieldDescriptor, placed: str) -> Iterator[str]:
    """The lines of a field: its name, type, default and comment."""
    key = ".".join(of.full_name.split(".")[-2:])
    read, compared = "", key not in NOT_COMPARED
    if of.name == placed:
        name, kind, read, compared = "in_map", "MapPose", f'in_map("{placed}")', False
    elif of.name == "covariance":
        name, kind, read, compared = of.name, "Matrix4", "covariance_of", False
    else:
        name, kind = NAMES.get(of.name, spelling(of)[0]), _kind(of)
        compared = compared and kind != "Matrix4"
        read = f"lambda message: tuple(message.{of.name})" if of.name in NAMES else ""
    optional = of.name == placed or _is_optional(of, key)
    yield f"    {name}: {kind}{' | None' if optional else ''}{_default(of, optional, compared, read)}"
    comment = MEANT.get(name) or " ".join(filter(None, (COMMENTS.get(of.full_name), _values(of))))
    yield from _comment(comment) if comment else ()


def _values(of: FieldDescriptor) -> str:
    """The values of an enum."""
    if of.enum_type is None:
        return ""
    *others, last = (one.name for one in of.enum_type.values if one.number)
    return f"{', '.join(others)} or {last}."


def _is_optional(of: FieldDescriptor, key: str) -> bool:
    if of.is_repeated:
        return False
    if of.message_type is not None:
        return key in POINTS or (of.message_type.name not in ("Vector3", "Struct") and key not in ALWAYS)
    return of.has_presence or key in NONE


def _default(of: FieldDescriptor, optional: bool, compared: bool, read: str) -> str:
    """The default of a field: None or the value that the message has where nobody says it; none for other messages."""
    default = ""
    if optional:
        default = "None"
    elif of.is_repeated and read != "covariance_of":
        default = "()"
    elif of.message_type is None and not read:
        default = '""' if of.enum_type is not None else repr(of.default_value).replace("''", '""')
    if compared and not read:
        return f" = {default}" if default else ""
    details = (f"default={default}" if default else "", "" if compared else "compare=False")
    parts = [*filter(None, details), *([f"metadata=read_by({read})"] if read else [])]
    return f" = field({', '.join(parts)})"


def _kind(of: FieldDescriptor) -> str:
    one = "str" if of.enum_type is not None else _SCALARS.get(of.cpp_type, "int")
    if of.message_type is not None:
        one = _KNOWN.get(of.message_type.name) or _name(of.message_type.name)
    return f"tuple[{one}, ...]" if of.is_repeated else one


def _name(message: str) -> str:
    return NAMES.get(message, message)


def _comment(text: str) -> list[str]:
    """A docstring in a class."""
    if len(text) <= 110:
        return [f'    """{text}"""']
    return [*textwrap.wrap(text, 120, initial_indent='    """', subsequent_indent="    "), '    """']

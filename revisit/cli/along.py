"""`revisit query --along`: a recording is driven, and the map is asked scan by scan where it is."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from revisit.cli.output import emit_json, say
from revisit.cli.recordings import opened
from revisit.cli.submap_names import short_name

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.sdk.resources import Relocalisation, RelocalisedPose


class Asked(Protocol):
    """A conversation: `revisit.sdk.conversations.Conversation`, or that of a map file."""

    def see(self, points: Any, T_odom_sensor: Any) -> Relocalisation:
        """The answer to one more scan."""
        ...


def relocalise_along(asked: Asked, folder: Path, every_m: float, as_json: bool) -> None:
    """Ask every so many metres of a recording, and say each answer as it comes; ends once the robot is placed."""
    answers = list[dict[str, Any]]()
    for scan in _asked_scans(opened(folder, "auto", None, None, None), every_m):
        answer = asked.see(scan.points, scan.T_odom_sensor)
        answers.append(asdict(answer))
        if not as_json:
            say(line_of(answer))
        if answer.state == "PLACED":
            break
    if as_json:
        emit_json(answers)


@contextmanager
def conversation(map_id: str, at: tuple[str, str], storey: str, exclude_session: str) -> Iterator[Asked]:
    """A conversation with the service `at` what --http and --grpc say."""
    from revisit.sdk.client import Client

    http, grpc = at
    with Client.grpc(grpc, http=http) as client:
        where = {"storey": storey or None, "exclude_session": exclude_session or None}
        with client.relocalise(f"maps/{map_id}", **where) as held:
            yield held


@contextmanager
def conversation_in_file(file: Path) -> Iterator[Asked]:
    """A conversation with a map file."""
    from revisit.area import AreaMap

    with AreaMap.open(file) as area:
        yield area.relocalise()


def line_of(answer: Relocalisation) -> str:
    """An answer as a line."""
    way = f"{answer.travelled_m:5.1f} m"
    if answer.state == "UNKNOWN":
        return f"{way}  UNKNOWN ({answer.reason})"
    first = f"{_where(answer.poses[0])}, probability {answer.poses[0].probability:.2f}"
    if answer.state == "PLACED":
        return f"{way}  PLACED  {first}"
    text = f"{way}  SEVERAL {len(answer.poses)}: {first}; none of them {answer.none_of_them:.2f}"
    drive = answer.tells_apart
    if drive is not None:
        text += f"; drive {drive.distance_m:.0f} m {_towards(drive.direction_rad)} to tell them apart"
    return text


def _where(pose: RelocalisedPose) -> str:
    T = pose.T_session_sensor if pose.in_map is None else pose.in_map.T_map
    if T is None:
        return "nowhere"
    frame = short_name(pose.session or "") if pose.in_map is None else pose.in_map.frame
    yaw_deg = math.degrees(math.atan2(T[1, 0], T[0, 0]))
    return f"x {T[0, 3]:.2f} y {T[1, 3]:.2f} z {T[2, 3]:.2f} m, yaw {yaw_deg:.1f} deg in {frame}"


def _towards(direction_rad: float) -> str:
    degrees = round(math.degrees(direction_rad))
    if degrees == 0:
        return "ahead"
    return "back" if abs(degrees) == 180 else f"{abs(degrees)} degrees to the {'left' if degrees > 0 else 'right'}"


def _asked_scans(recording: Recording, every_m: float) -> Iterator[Any]:
    """The first scan, and then one every so many metres."""
    travelled_m, asked_m, last = 0.0, -math.inf, None
    for index in range(len(recording)):
        position = recording.pose(index)[:3, 3]
        travelled_m += 0.0 if last is None else math.dist(position, last)
        last = position
        if travelled_m - asked_m >= every_m:
            asked_m = travelled_m
            yield recording.scan(index)

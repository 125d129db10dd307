"""Anchors in a file: a table (CSV) with a heading, or JSON as the interface has it."""

from __future__ import annotations

import csv
import difflib
import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from revisit.cli.moments import moment_ns
from revisit.cli.output import refuse
from revisit.core.errors import RevisitError
from revisit.core.geometry import se3

if TYPE_CHECKING:
    from revisit.sdk.anchors import NewAnchor

EARTH = ("latitude_deg", "longitude_deg", "altitude_m")
LOCAL = ("east_m", "north_m", "up_m")
SIGMAS = ("sigma_east_m", "sigma_north_m", "sigma_up_m")
OFFSET = ("offset_x_m", "offset_y_m", "offset_z_m")
POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
HEADING = ("heading_rad", "heading_sigma_rad")
COLUMNS = ("anchor_id", "kind", "time", *EARTH, *LOCAL, *SIGMAS, *OFFSET, *POSE, *HEADING, "tag")
"""Of a table. Those of a group are there together or not at all; `time` is a date with a time, or nanoseconds."""


def anchors_in(file: Path) -> list[NewAnchor]:
    """The anchors of a CSV or JSON file. Exits where it cannot be read as such, with the row."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise refuse(f"{file.name} is no text in UTF-8") from error
    found = _of_json(file.name, text) if file.suffix.lower() == ".json" else _of_table(file.name, text)
    if not found:
        raise refuse(f"{file.name} holds no anchors")
    return found


def _of_table(name: str, text: str) -> list[NewAnchor]:
    reader = csv.DictReader(io.StringIO(text))
    for column in reader.fieldnames or ():
        if column not in COLUMNS:
            near = difflib.get_close_matches(column, COLUMNS, n=1)
            hint = f"did you mean {near[0]}?" if near else f"they are {', '.join(COLUMNS)}"
            raise refuse(f"{name} has a column {column!r}, which is none of anchors: {hint}")
    if twice := [column for column, count in Counter(reader.fieldnames or ()).items() if count > 1]:
        raise refuse(f"{name} has the column {twice[0]} twice")
    try:
        return [_made(f"{name}, row {reader.line_num}", _of_row, row) for row in reader]
    except csv.Error as error:
        raise refuse(f"{name}, after row {reader.line_num}: {error}") from error


def _of_json(name: str, text: str) -> list[NewAnchor]:
    try:
        told = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise refuse(f"{name} is no JSON: {error}") from error
    rows = told.get("anchors") if isinstance(told, dict) else told
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise refuse(f"{name} must hold a list of anchors, or an object with such a list as `anchors`")
    from revisit.sdk.anchors import NewAnchor

    return [_made(f"{name}, anchor {number}", NewAnchor.of_json, row) for number, row in enumerate(rows, 1)]


def _made(where: str, make: Any, row: Mapping[str, Any]) -> NewAnchor:
    """One anchor. Exits where it has none of a field, or one that is no number."""
    try:
        made: NewAnchor = make(row)
    except KeyError as error:
        raise refuse(f"{where}: {error.args[0]} is missing") from error
    except (TypeError, ValueError, OverflowError, AttributeError, RevisitError) as error:
        raise refuse(f"{where}: {error}") from error
    return made


def _of_row(row: Mapping[str | None, Any]) -> NewAnchor:
    from revisit.sdk.anchors import NewAnchor

    if None in row:
        raise ValueError("it has more values than there are columns (numbers have points: 48.1)")
    told = {column: value.strip() for column, value in row.items() if column and value is not None and value.strip()}
    geodetic, local, pose, heading = (_numbers(told, group) for group in (EARTH, LOCAL, POSE, HEADING))
    return NewAnchor(
        told["anchor_id"],
        told["kind"].upper(),
        moment_ns(told["time"]) or 0,
        np.array([float(told[column]) for column in SIGMAS]),
        geodetic=None if geodetic is None else (geodetic[0], geodetic[1], geodetic[2]),
        local_m=None if local is None else (local[0], local[1], local[2]),
        offset_m=tuple(_numbers(told, OFFSET) or (0.0, 0.0, 0.0)),  # type: ignore[arg-type]  # three of them
        T_odom_sensor=None if pose is None else se3.from_quaternion(pose[3:], pose[:3]),
        heading_rad=None if heading is None else heading[0],
        heading_sigma_rad=None if heading is None else heading[1],
        tag=told.get("tag"),
    )


def _numbers(told: Mapping[str, str], columns: Sequence[str]) -> list[float] | None:
    """The numbers of a group of columns; None where a row has none of them. Raises KeyError, ValueError."""
    if not any(column in told for column in columns):
        return None
    return [float(told[column]) for column in columns]

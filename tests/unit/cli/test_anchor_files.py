"""Anchors in a table or in JSON, as `revisit anchors` reads them."""

from __future__ import annotations

import json
from dataclasses import asdict

import numpy as np
import pytest
import typer

from revisit.cli.anchor_files import COLUMNS, EARTH, HEADING, LOCAL, OFFSET, POSE, SIGMAS, anchors_in
from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.sdk.anchors import NewAnchor

T = se3.from_yaw(0.5, (1.0, 2.0, 0.3))
PLACED = se3.from_yaw(0.0, (1.0, 2.0, 0.3))  # its quaternion is read again to the bit
DOOR = NewAnchor("door", "CONTROL_POINT", 7, 0.01 * np.eye(3), None, (1.0, 0.0, 3.0), (4.0, 0.0, 0.0), PLACED)
HEAD = ",".join(["anchor_id", "kind", "time", *EARTH, *LOCAL, *SIGMAS, *OFFSET, *HEADING])
TABLE = f"""{HEAD}
fix-1,gnss,2026-11-27T16:30:00.5,48.1,11.5,520,,,,1.5,1.5,3,0.3,0,1.2,,
start,KNOWN_POSE,1000,,,,0,0,0,0.1,0.1,0.1,,,,1.5,0.01
"""


def written(folder, name, text):
    file = folder / name
    file.write_text(text)
    return file


def test_a_table_holds_fixes_and_points_in_metres(tmp_path):
    fix, start = anchors_in(written(tmp_path, "anchors.csv", TABLE))
    assert (fix.anchor_id, fix.kind, fix.stamp_ns) == ("fix-1", "GNSS", 1_795_797_000_500_000_000)
    assert (fix.geodetic, fix.local_m, fix.offset_m, fix.heading_rad) == (
        (48.1, 11.5, 520.0),
        None,
        (0.3, 0.0, 1.2),
        None,
    )
    assert fix.covariance_enu.tolist() == [1.5, 1.5, 3.0] and fix.T_odom_sensor is None
    assert (start.local_m, start.geodetic, start.stamp_ns) == ((0.0, 0.0, 0.0), None, 1000)
    assert (start.heading_rad, start.heading_sigma_rad) == (1.5, 0.01)


def test_a_table_and_json_may_hold_tags(tmp_path):
    head = ",".join(["anchor_id", "kind", "time", *SIGMAS, *OFFSET, "tag"])
    table = f"{head}\ns1,fiducial,5,0.03,0.03,0.05,2,1,0.5,tag36h11:17\n"
    (one,) = anchors_in(written(tmp_path, "tags.csv", table))
    assert (one.kind, one.tag, one.offset_m) == ("FIDUCIAL", "tag36h11:17", (2.0, 1.0, 0.5))
    assert one.geodetic is None and one.local_m is None
    (again,) = anchors_in(written(tmp_path, "tags.json", json.dumps([one.message()])))
    assert again.message() == one.message()


def test_a_table_may_hold_the_pose_of_the_sensor(tmp_path):
    x, y, z, w = se3.to_quaternion(T)
    row = ",".join(map(repr, (*map(float, T[:3, 3]), float(x), float(y), float(z), float(w))))
    head = ",".join(["anchor_id", "kind", "time", *LOCAL, *SIGMAS, *POSE])
    text = f"{head}\na,GNSS,5,0,0,0,1,1,1,{row}\n"
    (one,) = anchors_in(written(tmp_path, "anchors.csv", text))
    np.testing.assert_allclose(one.T_odom_sensor, T, atol=1e-12)


@pytest.mark.parametrize("wrap", [lambda rows: rows, lambda rows: {"anchors": rows}], ids=["list", "request"])
def test_json_is_as_a_request_has_it(tmp_path, wrap):
    (one,) = anchors_in(written(tmp_path, "anchors.json", json.dumps(wrap([DOOR.message()]))))
    assert one.message() == DOOR.message()


def test_an_answer_of_the_list_is_read_again(tmp_path):
    told = {**asdict(DOOR), "name": "maps/yard/sessions/monday/anchors/door", "state": "IN_MAP", "geodetic": None}
    del told["anchor_id"]
    told["covariance_enu"], told["T_odom_sensor"] = told["covariance_enu"].ravel().tolist(), PLACED.tolist()
    (one,) = anchors_in(written(tmp_path, "anchors.json", json.dumps([told])))
    assert one.anchor_id == "door"
    assert np.array_equal(one.T_odom_sensor, PLACED)
    assert (one.local_m, one.offset_m) == (DOOR.local_m, DOOR.offset_m)


@pytest.mark.parametrize(("name", "text", "told"), [
    ("a.csv", TABLE.replace("latitude_deg", "latitude_dg"),
     "column 'latitude_dg', which is none of anchors: did you mean latitude_deg?"),
    ("a.csv", TABLE.replace("48.1", ""), "a.csv, row 2: latitude_deg is missing"),
    ("a.csv", TABLE.replace(",1.5,1.5,3,", ",1.5,x,3,"), "a.csv, row 2: could not convert string to float: 'x'"),
    ("a.csv", TABLE.replace("1.5,0.01", "1.5,"), "a.csv, row 3: heading_sigma_rad is missing"),
    ("a.csv", TABLE.replace("2026-11-27T16:30:00.5", "noon"), "'noon' is no time"),
    ("a.csv", TABLE.replace("2026-11-27T16:30:00.5", ""), "a.csv, row 2: time is missing"),
    ("a.csv", TABLE.partition("\n")[0] + "\n", "a.csv holds no anchors"),
    ("a.json", "{}", "must hold a list of anchors"),
    ("a.json", "[1]", "must hold a list of anchors"),
    ("a.json", "[", "is no JSON"),
    ("a.json", '[{"anchor_id": "a", "kind": "GNSS", "stamp_ns": 1}]', "a.json, anchor 1: covariance_enu is missing"),
])  # fmt: skip
def test_a_file_that_cannot_be_read_says_where(tmp_path, capsys, name, text, told):
    with pytest.raises(typer.Exit):
        anchors_in(written(tmp_path, name, text))
    assert told in capsys.readouterr().err
    assert len(set(COLUMNS)) == len(COLUMNS)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.csv", TABLE.replace("48.1", "48,1"), "row 2: it has more values than there are columns"),
        ("a.csv", TABLE.replace("fix-1", "f" * 200_000), "after row 1: field larger than field limit"),
        ("a.csv", "anchor_id,kind,kind\n", "has the column kind twice"),
        ("a.json", "[" * 100_000, "is no JSON"),
        ("a.json", json.dumps([DOOR.message() | {"stamp_ns": 1e400}]), "anchor 1: cannot convert float infinity"),
        ("a.json", '[{"name": 5, "kind": "GNSS"}]', "anchor 1: 'int' object has no"),
    ],
    ids=["decimal comma", "long", "twice", "deep", "infinite", "name"],
)
def test_a_broken_file_is_refused_with_its_row(tmp_path, capsys, name, text, told):
    with pytest.raises(typer.Exit):
        anchors_in(written(tmp_path, name, text))
    assert told in capsys.readouterr().err


def test_a_standard_deviation_is_positive(tmp_path):
    fix, _ = anchors_in(written(tmp_path, "anchors.csv", TABLE.replace("1.5,1.5,3", "-1.5,1.5,3")))
    with pytest.raises(BadField, match="standard deviations must be positive"):
        fix.message()

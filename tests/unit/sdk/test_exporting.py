"""An exported pose graph is one that another optimiser reads: placed, fixed, weighed as measured."""

from __future__ import annotations

import json
import os
import sys
from importlib import metadata

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli import pose_graph_files
from revisit.cli.app import app, run
from revisit.cli.pose_graph_files import Graph, as_g2o
from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import ASSUMED_COVARIANCE
from revisit.sdk.resources import LoopClosure, Submap

COVARIANCE = np.diag([0.01, 0.04, 0.09, 1e-4, 1e-4, 4e-4])
T_MONDAY_TUESDAY = se3.from_yaw(1.0, (30.0, -20.0, 1.0))
"""Where Tuesday's odometry began, in Monday's."""


def a_submap(session, number, pose):
    name = f"maps/town/sessions/{session}/submaps/{number}"
    return Submap(name=name, ordinal=number, T_odom_submap=pose, position_m=(0.0, 0.0, 0.0), stamp_ns=number)


def a_loop(match, query, T_match_query, evidence):
    name = f"{match.name}-{query.name}"
    return LoopClosure(
        name=name, query=query.name, match=match.name, state="ACCEPTED", T_match_query=T_match_query, evidence=evidence
    )


def two_days(wrong=(), evidence=None):
    """Two drives over the same ten places, each in an odometry frame of its own, and a loop at each place."""
    places = [se3.from_yaw(0.1 * n, (4.0 * n, 0.3 * n, 0.0)) for n in range(10)]
    monday = [a_submap("monday", n, place) for n, place in enumerate(places)]
    tuesday = [a_submap("tuesday", n, se3.inverse(T_MONDAY_TUESDAY) @ place) for n, place in enumerate(places)]
    measured = {"measurement": {"covariance": COVARIANCE.tolist()}} if evidence is None else evidence
    loops = [
        a_loop(monday[n], tuesday[n], se3.from_yaw(0.0, (8.0, 8.0, 0.0)) if n in wrong else np.eye(4), measured)
        for n in range(10)
    ]
    return Graph([monday, tuesday], loops)


def parsed(text):
    """Vertices as (7,), ends of the edges with their information (6, 6), and the fixed vertices."""
    vertices, edges, fixed = {}, {}, []
    for kind, *words in (line.split() for line in text.splitlines()):
        if kind == "VERTEX_SE3:QUAT":
            vertices[int(words[0])] = np.array(words[1:], dtype=float)
        elif kind == "FIX":
            fixed.append(int(words[0]))
        else:
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = [float(word) for word in words[9:]]
            edges[int(words[0]), int(words[1])] = information
    return vertices, edges, fixed


def test_sessions_are_placed_by_their_loops_and_the_first_vertex_is_fixed():
    vertices, _, fixed = parsed(as_g2o(two_days()))
    assert fixed == [0]
    for n in range(10):
        np.testing.assert_allclose(vertices[n][:3], vertices[10 + n][:3], atol=0.01)


def test_a_wrong_loop_is_left_out():
    _, edges, _ = parsed(as_g2o(two_days(wrong=(4,))))
    loops = {ends for ends in edges if ends[1] - ends[0] == 10}
    assert (4, 14) not in loops and len(loops) == 9


def test_sessions_that_no_loops_join_are_fixed_each():
    graph = two_days()
    _, edges, fixed = parsed(as_g2o(Graph(graph.tracks, [])))
    assert fixed == [0, 10] and all(second == first + 1 for first, second in edges)


def test_the_rotation_of_a_loop_weighs_four_times_that_of_its_angle_as_g2o_measures_half_angles():
    _, edges, _ = parsed(as_g2o(two_days()))
    np.testing.assert_allclose(np.diag(edges[3, 13]), [100.0, 25.0, 100 / 9, 4e4, 4e4, 1e4], rtol=1e-6)


@pytest.mark.parametrize("evidence", [{}, {"measurement": {}}, {"measurement": {"covariance": [[None] * 6] * 6}}])
def test_a_loop_without_a_measured_covariance_weighs_what_is_assumed(evidence):
    _, edges, _ = parsed(as_g2o(two_days(evidence=evidence)))
    expected = 1 / np.diag(ASSUMED_COVARIANCE) * [1, 1, 1, 4, 4, 4]
    np.testing.assert_allclose(np.diag(edges[3, 13]), expected, rtol=1e-6)


def shown(monkeypatch, graph, *arguments):
    monkeypatch.setattr(pose_graph_files, "read_graph", lambda *_: graph)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_pose_graph_says_where_sessions_lie_and_which_loops_that_rests_on(monkeypatch, tmp_path):
    graph = two_days(wrong=(4,))
    answer = json.loads(
        shown(monkeypatch, graph, "map", "optimise", "--here", "--out", tmp_path / "town", "--json").stdout
    )
    monday, tuesday = answer["sessions"]
    assert [one["frame"] for one in (monday, tuesday)] == ["maps/town/sessions/monday"] * 2
    found = [tuesday["T_map_odom"]["translation"][axis] for axis in "xyz"]
    np.testing.assert_allclose(found, T_MONDAY_TUESDAY[:3, 3], atol=0.05)
    assert sorted(loop["state"] for loop in answer["loops"]) == ["IN_MAP"] * 9 + ["SET_ASIDE"]
    assert sorted(file.name for file in (tmp_path / "town").iterdir()) == ["graph.g2o", "monday.tum", "tuesday.tum"]
    # In the map, the two drives are one.
    first, second = (np.loadtxt(tmp_path / "town" / f"{day}.tum") for day in ("monday", "tuesday"))
    np.testing.assert_allclose(first[:, 1:4], second[:, 1:4], atol=0.05)
    assert "9 in the map, 1 set aside" in shown(monkeypatch, graph, "map", "optimise", "--here").stdout


@pytest.mark.parametrize("command", [["map", "optimise", "--here"], ["export"]])
def test_without_scipy_one_line_says_what_to_install(monkeypatch, command):
    for name in [name for name in sys.modules if name.startswith("revisit.core.pose_graph")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "scipy.sparse", None)
    refused = shown(monkeypatch, two_days(), *command)
    assert refused.exit_code != 0
    assert "scipy.sparse is not installed" in refused.stderr + str(refused.exception)


def test_the_command_says_its_version_and_completes():
    assert CliRunner().invoke(app, ["--version"]).stdout == f"revisit {metadata.version('revisit-loops')}\n"
    assert "--install-completion" in CliRunner().invoke(app, ["--help"]).stdout


def test_no_command_lets_grpc_write_into_its_progress(monkeypatch):
    monkeypatch.setenv("GRPC_VERBOSITY", "")  # so that it is put back
    monkeypatch.delenv("GRPC_VERBOSITY")
    monkeypatch.setattr(sys, "argv", ["revisit", "--version"])
    with pytest.raises(SystemExit):
        run()
    assert os.environ["GRPC_VERBOSITY"] == "NONE"

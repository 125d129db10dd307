"""An exported pose graph carries the weights that the service measured."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.cli.pose_graph_files import ODOMETRY_INFORMATION, Graph, as_g2o
from revisit.core.geometry import se3
from revisit.sdk.resources import LoopClosure, Submap

# The query stands 2 m ahead of the match, turned left by 90 degrees.
T_MATCH_QUERY = se3.from_quaternion((0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)), (2.0, 0.0, 0.0))


def a_submap(name):
    return Submap(
        name, "DESCRIBED", 0, np.eye(4), (0.0, 0.0, 0.0), 0, None, None, 1, 100, 1200, None, (), "m-1", "operations/o"
    )


def loop_edge(evidence):
    loop = LoopClosure("loop", 1, "query", "match", "ACCEPTED", None, 0.9, 0.9, T_MATCH_QUERY, evidence, 0)
    text = as_g2o(Graph([[a_submap("match")], [a_submap("query")]], [loop]))
    (edge,) = [line.split() for line in text.splitlines() if line.startswith("EDGE")]
    information = np.zeros((6, 6))
    information[np.triu_indices(6)] = [float(number) for number in edge[10:]]
    return edge[1:3], information


def test_a_loop_edge_leads_from_the_match_to_the_query_with_the_covariance_turned_into_the_query_frame():
    # 0.1 m along x of the match, which is the query's -y; 0.2 m along its y, the query's x.
    covariance = np.diag([0.01, 0.04, 0.09, 1e-4, 1e-4, 1e-12])
    ends, information = loop_edge({"measurement": {"covariance": covariance.tolist()}, "thresholds": {}})
    assert ends == ["0", "1"]
    np.testing.assert_allclose(np.diag(information)[[0, 1]], [1 / 0.04, 1 / 0.01], rtol=1e-3)


@pytest.mark.parametrize("evidence", [{}, {"measurement": {}}, {"measurement": {"covariance": [[None] * 6] * 6}}])
def test_a_loop_without_a_measured_covariance_weighs_as_odometry_does(evidence):
    np.testing.assert_array_equal(loop_edge(evidence)[1], np.triu(ODOMETRY_INFORMATION))

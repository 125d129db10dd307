"""Stretches that are taken for others have one vote each: what guards a map holds beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

from lab.pose_graphs.one_loop import SESSION, grid_drive
from lab.pose_graphs.one_vote import Case, outcome, table
from revisit.core.pose_graph.g2o import write_g2o
from tests.support.real_data import needs_real_data, real_data


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A made-up drive as a file."""
    graph, made = grid_drive(800, 0, blocks=4), tmp_path_factory.mktemp("graphs")
    (made / "grid.g2o").write_text(write_g2o(graph, {SESSION: graph.trajectories[0].T_odom_submap}))
    return made


def test_a_heading_that_turns_is_found_beside_a_stretch_taken_for_another(folder: Path) -> None:
    plain, spoilt = (outcome(folder, Case("grid", None, 0.1, stretches, 18), seeds=1) for stretches in (0, 1))
    assert plain.bias_deg_m == pytest.approx(0.1, abs=0.02)
    assert spoilt.bias_deg_m == pytest.approx(plain.bias_deg_m, abs=0.001)
    assert (spoilt.right_kept, spoilt.wrong_kept) == (plain.right_kept, 0)
    assert "| grid, " in table([plain, spoilt])


def test_so_many_loops_of_a_graph_are_left_as_are_asked_for(folder: Path) -> None:
    assert outcome(folder, Case("grid", 20, 0.0, 0, 9)).right == 20


@pytest.mark.real_data
@needs_real_data
@pytest.mark.parametrize("case", [Case("kitti_05", 43, 0.02, 1, 18), Case("CSAIL", 20, 0.0, 1, 9)], ids=str)
def test_one_stretch_taken_for_another_turns_off_no_guard_of_a_recorded_graph(case: Case) -> None:
    found = outcome(real_data() / "graphs", case, seeds=1)
    assert found.bias_deg_m == pytest.approx(case.turned_deg_m, abs=0.006)  # the recording has a bias of its own
    assert (found.factor, found.right_kept, found.wrong_kept) == (1.0, found.right, 0)

"""Resources as tables: what is in a field is in a column of its name."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from revisit import to_dataframe
from revisit.core.geometry import se3
from revisit.sdk.own_resources import MapTile
from revisit.sdk.resources import LoopPolicy, Map, SubmapPose

pytest.importorskip("pandas", reason="in the extra `dev`: makes the tables")


def test_each_resource_is_a_row_and_each_field_a_column():
    maps = [Map(name=f"maps/{n}", tau_m=10.0 * n, loop_policy=LoopPolicy(candidates=n)) for n in (1, 2)]
    table = to_dataframe(maps)
    assert list(table["name"]) == ["maps/1", "maps/2"] and list(table["tau_m"]) == [10.0, 20.0]
    assert list(table["loop_policy.candidates"]) == [1, 2]


def test_a_transform_is_seven_numbers_and_a_vector_its_own():
    pose = se3.from_quaternion((0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)), (1.0, 2.0, 3.0))
    table = to_dataframe([SubmapPose(submap="a", T_map_submap=pose, covariance=np.eye(6))])
    row = table.iloc[0]
    columns = [f"T_map_submap.{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    assert np.allclose(row[columns].astype(float), [1, 2, 3, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    tile = MapTile(name="t", frame="f", min_m=(0.0, 1.0), max_m=(51.2, 52.2), submaps=1, made=True)
    assert to_dataframe([tile]).iloc[0]["max_m.y"] == 52.2


def test_nothing_is_an_empty_table_and_without_pandas_a_sentence_says_what_to_install(monkeypatch):
    assert len(to_dataframe([])) == 0
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match="pip install pandas"):
        to_dataframe([])

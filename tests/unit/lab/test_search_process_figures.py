"""The figures of searches in a search process come from real answers, which are right."""

from __future__ import annotations

import json

from lab.cluster import search


def test_a_small_map_is_answered_by_another_process_as_the_exact_index_does(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["search", "2000", "--searches", "10"])
    search.main()
    figures = json.loads(capsys.readouterr().out)
    assert figures["places"] == 2000
    for name in ("all", "10 %", "1 %"):
        assert figures[name]["recall"] == 1.0
        assert figures[name]["CPU ms"] > 0.0 and 0.0 < figures[name]["p50 ms"] <= figures[name]["p99 ms"]

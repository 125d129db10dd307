"""The stored window follows `core.submap.SubmapBuilder` scan by scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from revisit.core.config import SubmapConfig
from revisit.core.scan import CloudReport, Scan
from revisit.core.scan_marks import ScanMarks
from revisit.core.submap import SubmapBuilder
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import ScanRecord, SessionRecord
from revisit.service.features.ingest.appending import advance

NEW = SessionRecord(
    TenantId("t"), "town", "run", "", None, "ACTIVE", 0, 1, 0.0, 0.0, 1, None, created_at_ns=0, finished_at_ns=None
)
ROW = ScanRecord(NEW.tenant, NEW.map_id, NEW.session_id, 1, 0, (), 0.0, 1, "")
STEPS_M = st.lists(st.one_of(st.just(0.0), st.floats(0.01, 3.0), st.floats(8.0, 40.0)), min_size=1, max_size=60)


def scan_at(x_m: float, seq: int) -> Scan:
    T_odom_sensor = np.eye(4)
    T_odom_sensor[0, 3] = x_m
    return Scan(np.zeros((1, 3), dtype=np.float32), T_odom_sensor, seq, CloudReport(0, degenerate_plane=False))


@settings(max_examples=150, deadline=None)
@given(steps_m=STEPS_M, tau=st.floats(1.0, 12.0), stride=st.floats(0.5, 15.0))
def test_windows_are_those_of_the_builder(steps_m, tau, stride):
    config = SubmapConfig(tau=tau, stride=stride)
    builder, session = SubmapBuilder(config), NEW
    travelled, x_m, marks, last, way = {}, 0.0, ScanMarks.of(config), None, None

    def first_seq_from(start_m):
        return min((seq for seq, distance in travelled.items() if distance >= start_m), default=None)

    for seq, step_m in enumerate(steps_m, start=1):
        x_m += 0.0 if seq == 1 else step_m
        built, scan = builder.add(scan_at(x_m, seq)), scan_at(x_m, seq)
        way = marks.way_to(scan.T_odom_sensor, way)
        travelled[seq] = way.travelled_m
        chosen = marks.choose(last, travelled[seq], scan.T_odom_sensor, len(scan.points))
        last = chosen or last
        session = replace(session, committed_seq=seq, travelled_m=travelled[seq])
        row = replace(ROW, seq=seq, travelled_m=travelled[seq], chosen=chosen is not None)
        session, finished = advance(session, row, config, first_seq_from)
        assert (finished is None) == (built is None)
        if built is not None and finished is not None:
            # A range may begin with scans that are not described.
            assert finished.first <= built[0].stamp_ns and finished.last == built[-1].stamp_ns

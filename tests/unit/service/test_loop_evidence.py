"""What the evidence of a verdict tells a client."""

from __future__ import annotations

import json

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.verification import Hypothesis, LoopMeasurement, RejectedLoop, RejectionReason
from revisit.service.adapters import core_recogniser


def test_the_rivals_of_an_ambiguous_loop_are_told_with_their_overlap_and_pose() -> None:
    rival = Hypothesis(0.625, se3.from_yaw(0.0, (8.0, 0.0, 0.0)))
    measurement = LoopMeasurement(0.9, 30, 0.4, 0.7, 0.3, 0.02, 0.05, 0.9, np.eye(4), np.eye(6), (rival,))
    verdict = RejectedLoop(RejectionReason.AMBIGUOUS, measurement)
    evidence = json.loads(json.dumps(core_recogniser._evidence(verdict, PipelineConfig()), allow_nan=False))
    told = evidence["measurement"]["rivals"]
    assert told == [{"overlap": 0.625, "T_match_query": rival.T_match_query.tolist()}]

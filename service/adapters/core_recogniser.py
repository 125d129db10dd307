"""The method of `core` behind the recogniser port. Only worker processes import it: it brings torch."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np

from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.errors import DataLoss, RevisitError
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.implicit_map import NeuralMap
from revisit.core.kernels.intermediate_code import pack_intermediate_code
from revisit.core.kernels.plane_votes import plane_scores
from revisit.core.model_bundle import ModelBundle, load_packaged_models
from revisit.core.pipeline import DescribedPlace, describe, describe_again, verify
from revisit.core.place import Place
from revisit.core.pose_graph import normal_equations
from revisit.core.sanity.window import window_findings
from revisit.core.scan import Scan
from revisit.core.scan_disagreement import ScanDisagreement
from revisit.core.stages import stage_times
from revisit.core.submap import Submap
from revisit.core.verification import Hypothesis, LoopMeasurement, RejectedLoop, VerifiedLoop
from revisit.formats import quantised_columns
from revisit.formats.glb import encode_scene
from revisit.service.application.contract.recogniser import LoopVerdict, Mesh, Redescription, SubmapDescription

SETTABLE = ("min_score", "min_overlap", "max_seen_through")
"""The thresholds that an operator may set (see `contract.loop_policy`): written beside each verdict."""

VERSION_DIGITS = 12

PLACES_READ = 192
"""Places that a worker keeps unpacked, the last ones it used: candidates come again with a robot's next submap, and a
worker serves several robots by turns (docs/decisions/0222). 0.1 MB each, and 5 ms to read.
"""

PLACES_PREPARED = 24
"""Places of these that are kept with what verification has made of them: 1.3 MB more each, and 2 ms. A job asks most of
its candidates twice, and few that an earlier job had asked (docs/decisions/0288).
"""


class CoreRecogniser:
    """`PlaceRecogniser` with the packaged models."""

    def __init__(self, models: ModelBundle) -> None:
        """`models` are loaded once per process."""
        self._models = models
        self._read = lru_cache(maxsize=PLACES_READ)(Place.from_blob)
        self._place = lru_cache(maxsize=PLACES_PREPARED)(self._unprepared)

    @property
    def model_version(self) -> str:
        """See `PlaceRecogniser`."""
        return self._models.version

    def inspect(self, scans: Sequence[Scan]) -> tuple[str, ...]:
        """See `PlaceRecogniser`."""
        return tuple(finding.code for finding in window_findings(scans, plane_scores))

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """See `PlaceRecogniser`."""
        with stage_times() as timings_s:
            described = describe(submap, self._models, config)
        return SubmapDescription(
            descriptor=described.descriptor.vector,
            place=described.place.to_blob(),
            neural_map=described.neural_map.to_blob(),
            mesh=_mesh(described),
            flags=described.flags,
            timings_s=timings_s,
        )

    def describe_again(self, neural_map: bytes, place: bytes | None, config: PipelineConfig) -> Redescription:
        """See `PlaceRecogniser`."""
        stored = NeuralMap.from_blob(neural_map, self._models.decoder, config.implicit_map)
        described = describe_again(stored, self._models, config)
        again = dataclasses.replace(described.place, scan_disagreement=_disagreement_of(place))
        return Redescription(described.descriptor.vector, again.to_blob())

    def verify(
        self,
        query: bytes,
        match: bytes,
        similarity: float,
        config: PipelineConfig,
        near: Matrix4 | None = None,
        *,
        near_decides: bool = True,
        expected: Matrix4 | None = None,
    ) -> LoopVerdict:
        """See `PlaceRecogniser`."""
        places = self._place(query), self._place(match)
        verdict = verify(*places, similarity, config.verification, near, near_decides=near_decides, expected=expected)
        evidence = _evidence(verdict, config)
        if isinstance(verdict, VerifiedLoop):
            measured = verdict.measurement
            return LoopVerdict(True, None, float(measured.score), measured.T_match_query, evidence)
        measured_anyway = verdict.measurement
        if measured_anyway is None:
            return LoopVerdict(False, verdict.reason.value, 0.0, None, evidence)
        score = float(measured_anyway.score)
        return LoopVerdict(False, verdict.reason.value, score, measured_anyway.T_match_query, evidence)

    def let_go(self) -> None:
        """See `PlaceRecogniser`. Places stay as they were read: that takes longer than what is made of them."""
        self._place.cache_clear()

    def _unprepared(self, blob: bytes) -> Place:
        """A place of its own over the arrays of the one that was read: what is computed of it goes with it."""
        return dataclasses.replace(self._read(blob))


def load_recogniser() -> CoreRecogniser:
    """The recogniser that the workers use, warmed up: what is compiled at first use is compiled by now."""
    recogniser = CoreRecogniser(load_packaged_models())
    warm_up(recogniser)
    pack_intermediate_code()
    return recogniser


def warm_up(recogniser: CoreRecogniser) -> None:
    """Do once what a worker does with scans, submaps, pairs and poses, for the compilers' sake alone.

    What it compiled in the middle of its life would cost a job some seconds, and the worker memory for good.
    """
    config = PipelineConfig()
    quantised_columns.rehearse()  # first: the gateway decodes scans, too, and loads what was compiled here
    normal_equations.rehearse()  # maps are optimised in the same process
    # Whether these yards can be described does not matter; a fault that matters will show on a real submap.
    with suppress(RevisitError):
        scans = _made_up_scans(seed=0)
        recogniser.inspect(scans)
        yard, other = (
            recogniser.describe(Submap.from_scans(some, config.submap), config)
            for some in (scans, _made_up_scans(seed=1))
        )
        recogniser.verify(yard.place, yard.place, 1.0, config)
        recogniser.verify(yard.place, other.place, 1.0, config)  # few keypoints agree: images are compared
        encode_scene(yard.mesh.vertices, yard.mesh.faces)  # for the gateway again
        if yard.neural_map is not None:  # fields are asked where maps are merged and drawn
            field = NeuralMap.from_blob(yard.neural_map, load_packaged_models().decoder, config.implicit_map)
            field.neighbourhood(yard.mesh.vertices)


def _made_up_scans(seed: int) -> list[Scan]:
    """A floor of 40 x 40 m with four walls, 4 points a square metre, from three spots by a sensor that leans."""
    rng = np.random.default_rng(seed)
    floor = np.column_stack([rng.uniform(-20, 20, (6400, 2)), np.full(6400, -1.7)])
    walls = []
    for along_x in (True, True, False, False):
        along, up = rng.uniform(-6, 6, 600), rng.uniform(-1.7, 4, 600)
        (x, y), across = rng.uniform(-14, 14, 2), np.zeros(600)
        walls.append(np.column_stack([x + (along if along_x else across), y + (across if along_x else along), up]))
    yard, scans = np.vstack([floor, *walls]), []
    for stamp_s, x in enumerate((0.0, 2.5, 5.0)):
        T_odom_sensor = se3.exp(np.array([x, 0.0, 0.0, 0.02, 0.01, 0.0]))
        scans.append(Scan.validated(se3.apply(se3.inverse(T_odom_sensor), yard), T_odom_sensor, stamp_s * 10**9))
    return scans


def _disagreement_of(place: bytes | None) -> ScanDisagreement | None:
    """What the scans of a stored place disagree on (docs/decisions/0194); None where nothing readable says so."""
    if place is None:
        return None
    try:
        return Place.from_blob(place).scan_disagreement
    except DataLoss:
        return None


def _mesh(described: DescribedPlace) -> Mesh:
    """The surface in the frame of the submap."""
    normals = described.frame.normals_to_submap(described.surface.normals)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    vertices = described.frame.points_to_submap(described.surface.vertices)
    return Mesh(vertices.astype(np.float32), normals.astype(np.float32), described.surface.faces)


def _evidence(verdict: VerifiedLoop | RejectedLoop, config: PipelineConfig) -> dict[str, Any]:
    """What was measured and against which thresholds, as JSON."""
    measurement: LoopMeasurement | None = verdict.measurement
    measured = {} if measurement is None else _as_json(measurement)
    return {"measurement": measured, **_thresholds(config.verification)}


@lru_cache(maxsize=64)
def _thresholds(rules: VerificationConfig) -> dict[str, Any]:
    """Which rules gave the verdict: those that an operator sets, others that are not the default, and a hash of all.

    Kept, because each candidate of a map has the same ones; nobody changes what is answered.
    """
    values, defaults = _as_json(rules), _as_json(VerificationConfig())
    told = {name: value for name, value in values.items() if name in SETTABLE or value != defaults[name]}
    digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
    return {"thresholds": told, "thresholds_version": digest[:VERSION_DIGITS]}


def _as_json(record: Any) -> dict[str, Any]:
    """The fields of a flat dataclass of numbers, strings and arrays; a non-finite number becomes None."""
    return {field.name: _json_value(getattr(record, field.name)) for field in dataclasses.fields(record)}


def _json_value(value: Any) -> Any:
    if isinstance(value, Hypothesis):
        return _as_json(value)
    if isinstance(value, np.ndarray):
        return [_json_value(item) for item in value.tolist()]
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    if isinstance(value, np.generic):
        return _json_value(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value

"""The method of `core` behind the recogniser port. Only worker processes import it: it brings the compiler, and torch
with the first submap of a map in the form of the paper.
"""

from __future__ import annotations

import dataclasses
from collections import OrderedDict
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from revisit.core.codec.mesh import Mesh
from revisit.core.config import PipelineConfig, Profile
from revisit.core.errors import DataLoss
from revisit.core.implicit_map import NeuralMap
from revisit.core.kernels.intermediate_code import pack_intermediate_code
from revisit.core.kernels.plane_votes import plane_scores
from revisit.core.model_bundle import ModelBundle
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.pipeline import describe_again, describe_fitted, fit, verify
from revisit.core.place import Place
from revisit.core.profiles import profile_models
from revisit.core.sanity.window import window_findings
from revisit.core.scan import Scan
from revisit.core.scan_disagreement import ScanDisagreement
from revisit.core.stages import stage_times
from revisit.core.submap import Submap
from revisit.core.surface import extract_surface
from revisit.service.adapters.core_neural_maps import written
from revisit.service.adapters.warmup import accompany, warm_up
from revisit.service.large_blocks import return_free_memory
from revisit.service.ports.recogniser import SubmapDescription

PLACES_READ = 96
"""Places that a worker keeps unpacked, the last ones it used: candidates come again with a robot's next submap, and a
worker serves several robots by turns (docs/decisions/0289). 0.1 MB each, and 4 ms to read.
"""

PLACES_PREPARED = 24
"""Places of these that are kept with their derived data of verification: 1.3 MB more each, and 2 ms. A job asks most of
its candidates twice, and few that an earlier job had asked (docs/decisions/0289).
"""


class CoreRecogniser:
    """`PlaceRecogniser` with the packaged models of the profile that is asked for, loaded once per process."""

    def __init__(self) -> None:
        """The product's are loaded now, those of another profile when it is asked for first."""
        self._models = {Profile.PRODUCT: profile_models(Profile.PRODUCT)}
        self._read = ReadPlaces(PLACES_READ)
        self._place = lru_cache(maxsize=PLACES_PREPARED)(self._unprepared)

    def model_of(self, profile: Profile) -> str:
        """See `PlaceRecogniser`."""
        return self._models_of(profile).version

    def _models_of(self, profile: Profile) -> ModelBundle:
        if profile not in self._models:
            self._models[profile] = profile_models(profile)
        return self._models[profile]

    def inspect(self, scans: Sequence[Scan]) -> tuple[str, ...]:
        """See `PlaceRecogniser`."""
        return tuple(finding.code for finding in window_findings(scans, plane_scores))

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """See `PlaceRecogniser`."""
        models = self._models_of(config.profile)
        with stage_times() as timings_s:
            fitted = fit(submap, models, config)
            del submap  # 20 MB of points, where the caller does not hold them either
            described = describe_fitted(fitted, models, config)
        place = described.place.to_blob()
        self._read.keep(place, described.place.as_stored(place))  # it is compared next
        return SubmapDescription(
            descriptor=described.descriptor.vector,
            place=place,
            neural_map=written(described.neural_map),
            flags=described.flags,
            timings_s=timings_s,
        )

    def describe_again(self, neural_map: bytes, place: bytes | None, config: PipelineConfig) -> SubmapDescription:
        """See `PlaceRecogniser`."""
        described = describe_again(self._neural_map(neural_map, config), self._models_of(config.profile), config)
        again = dataclasses.replace(described.place, scan_disagreement=_disagreement_of(place))
        return SubmapDescription(described.descriptor.vector, again.to_blob())

    def mesh(self, neural_map: bytes, config: PipelineConfig) -> Mesh:
        """See `PlaceRecogniser`."""
        stored = self._neural_map(neural_map, config)
        surface = extract_surface(stored, config.surface)
        normals = stored.frame.normals_to_submap(surface.normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        vertices = stored.frame.points_to_submap(surface.vertices)
        return Mesh(vertices.astype(np.float32), normals.astype(np.float32), surface.faces)

    def _neural_map(self, blob: bytes, config: PipelineConfig) -> NeuralMap:
        return NeuralMap.from_blob(blob, self._models_of(config.profile).decoder, config.implicit_map)

    def verify(
        self, query: bytes, match: bytes, similarity: float, config: PipelineConfig, initial: InitialPose | None = None
    ) -> PairVerdict:
        """See `PlaceRecogniser`."""
        return verify(self._place(query), self._place(match), similarity, config.verification, initial)

    def release(self) -> None:
        """See `PlaceRecogniser`. Places stay as they were read: reading takes longer than deriving."""
        self._place.cache_clear()
        return_free_memory()  # a caller that needs room gets idle memory, too

    def _unprepared(self, blob: bytes) -> Place:
        """A place of its own over the arrays of the one that was read: derived data goes with it."""
        return dataclasses.replace(self._read(blob))


class ReadPlaces:
    """Unpacked places by their stored form: those that were used last."""

    def __init__(self, most: int) -> None:
        """At most so many."""
        self._most = most
        self._places: OrderedDict[bytes, Place] = OrderedDict()

    def __call__(self, blob: bytes) -> Place:
        """The place. Raises FormerForm, DataLoss."""
        known = self._places.pop(blob, None)
        place = Place.from_blob(blob) if known is None else known
        self.keep(blob, place)
        return place

    def keep(self, blob: bytes, place: Place) -> None:
        """Keep a place that is known otherwise."""
        self._places[blob] = place
        self._places.move_to_end(blob)
        while len(self._places) > self._most:
            self._places.popitem(last=False)


def load_recogniser() -> CoreRecogniser:
    """The recogniser of the workers, with all its kernels compiled."""
    recogniser = CoreRecogniser()
    warm_up(recogniser)
    pack_intermediate_code()
    return recogniser


def accompany_worker() -> None:
    """Compile in a process of its own, from the other end of the worker's list."""
    accompany(CoreRecogniser())


def _disagreement_of(place: bytes | None) -> ScanDisagreement | None:
    """Disagreement of the scans of a stored place (docs/decisions/0081); None where it is not readable."""
    if place is None:
        return None
    try:
        return Place.from_blob(place).scan_disagreement
    except DataLoss:
        return None

"""Verdicts on loop candidates: gates from cheap to dear, one score, a pose with covariance (paper III-E, end)."""

from __future__ import annotations

import dataclasses
from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.errors import DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import motion_between_levels, motion_between_submaps
from revisit.core.pair_verdict import (
    Authority,
    Hypothesis,
    InitialPose,
    LoopMeasurement,
    PairVerdict,
    RejectedLoop,
    RejectionReason,
    VerifiedLoop,
)
from revisit.core.place import Place
from revisit.core.scan_disagreement import ScanDisagreement
from revisit.core.verification.evidence import Evidence, gather_evidence
from revisit.core.verification.height_doubt import height_doubt_m
from revisit.core.verification.keypoint_fit import KeypointFit
from revisit.core.verification.oriented_points import OrientedPoints
from revisit.core.verification.registration import Registration, observability, reconsider, register
from revisit.core.verification.rivals import find_rivals
from revisit.core.verification.start import find_start, start_at


def verify(
    query: Place,
    match: Place,
    similarity: float,
    config: VerificationConfig,
    initial: InitialPose | None = None,
) -> PairVerdict:
    """Whether two submaps show the same place, and how they lie to each other: SE(2) start, ICP, gates.

    Registration starts from `initial`, if there is one, as its authority says. A wrong hint costs time alone.

    Nothing in it is random, and the answer does not depend on which place is the query: `verify(b, a)` has the verdict,
    reason and evidence of `verify(a, b)`, and the inverse pose. Raises DescriptorModelMismatch where the places come
    from different codebooks or scene scales.
    """
    if initial is not None and initial.authority is Authority.HINT:
        competing = dataclasses.replace(initial, authority=Authority.COMPETES)
        found = verify(query, match, similarity, config, competing)
        return found if isinstance(found, VerifiedLoop) else verify(query, match, similarity, config)
    if query.content_digest <= match.content_digest:
        return _verify_in_order(query, match, similarity, config, initial)
    exchanged = initial and dataclasses.replace(initial, T_match_query=se3.inverse(initial.T_match_query))
    return _inverted(_verify_in_order(match, query, similarity, config, exchanged))


def _verify_in_order(
    query: Place,
    match: Place,
    similarity: float,
    config: VerificationConfig,
    initial: InitialPose | None,
) -> PairVerdict:
    """The verdict on two places in the order of their content digests.

    Registration is not symmetric: its small differences would decide close cases (docs/decisions/0061).
    """
    if query.model != match.model or abs(query.frame.scale - match.frame.scale) > 1e-6:
        raise DescriptorModelMismatch
    if is_degenerate(query, config) or is_degenerate(match, config):
        return RejectedLoop(RejectionReason.DEGENERATE_PLACE)
    start = (
        find_start(query, match, config)
        if initial is None
        else start_at(motion_between_levels(initial.T_match_query, query.frame, match.frame), query, match, config)
    )
    surfaces = OrientedPoints.of(query), OrientedPoints.of(match)
    registration = register(start.poses, *surfaces, config)
    measurement, reason = _judged(registration, start.fit, query, match, similarity, config)
    other = reconsider(registration, *surfaces, config) if reason in _OF_A_POSE else None
    if other is not None:
        measurement, reason = _judged(other, start.fit, query, match, similarity, config)
    if reason in _WITH_RIVALS and not (initial is not None and initial.authority is Authority.DECIDES):
        rivals = find_rivals(measurement.T_match_query, *surfaces, config, repeats=reason is None)
        measurement = dataclasses.replace(measurement, rivals=rivals)
        reason = RejectionReason.AMBIGUOUS if rivals else reason
    if reason in _TOLD:
        measurement = _doubted(measurement, *surfaces)
    measurement = _unlevelled(measurement, query, match, config)
    return VerifiedLoop(measurement) if reason is None else RejectedLoop(reason, measurement)


_OF_A_POSE = (
    RejectionReason.DEGENERATE_ALIGNMENT,
    RejectionReason.IMPLAUSIBLE_TILT,
    RejectionReason.SEEN_THROUGH,
    RejectionReason.LOW_SCORE,
)
"""Reasons that a wrong pose has which shares much surface: then the starts that were left out are asked."""

_WITH_RIVALS = (None, RejectionReason.LOW_SCORE)
"""Verdicts after which other poses that fit are sought. Where a place repeats, little is lost aside: a low score."""

_TOLD = (None, RejectionReason.AMBIGUOUS)
"""Verdicts whose pose is told to others, with its covariance."""


def _doubted(measurement: LoopMeasurement, query: OrientedPoints, match: OrientedPoints) -> LoopMeasurement:
    """The measurement, between level frames, less sure of its height where other level surfaces could meet."""
    doubt = height_doubt_m(query, match, measurement.T_match_query)
    along_z = np.diag(np.square([0.0, 0.0, doubt, 0.0, 0.0, 0.0]))
    return dataclasses.replace(measurement, covariance=measurement.covariance + along_z)


def _judged(
    registration: Registration,
    fit: KeypointFit,
    query: Place,
    match: Place,
    similarity: float,
    config: VerificationConfig,
) -> tuple[LoopMeasurement, RejectionReason | None]:
    """What is measured of a registration, in the level frames, and the first gate that it does not pass."""
    evidence = gather_evidence(registration, OrientedPoints.of(query), OrientedPoints.of(match), config)
    measurement = _measure(fit, registration, evidence, similarity, config)
    sure = evidence.overlap >= config.sure_overlap and measurement.score >= config.sure_score
    share = min(config.min_common_share, config.min_common_share_sure) if sure else config.min_common_share
    standing = min(query.standing_count, match.standing_count)
    enough = max(config.min_common, share * standing)
    measurement = dataclasses.replace(
        measurement, common_share=evidence.common / max(standing, 1), enough_share=enough / max(standing, 1)
    )
    return measurement, _rejection(registration, evidence, measurement.score, enough, config)


def is_degenerate(place: Place, config: VerificationConfig) -> bool:
    """Whether a place cannot be verified: too little stands on its ground, or what stands there is one line or wall."""
    return place.standing_count < config.min_standing or place.kept(_narrowest_spread) < config.min_spread


def _narrowest_spread(place: Place) -> float:
    """The smallest horizontal standard deviation of what stands."""
    plan = place.points[: place.standing_count, :2].astype(np.float64)
    plan -= plan.mean(axis=0)
    covariance = plan.T @ plan / max(len(plan) - 1, 1)
    return float(np.sqrt(np.clip(np.linalg.eigvalsh(covariance), 0.0, None))[0])


def systematic_covariance(
    T_match_query: se3.Matrix4,
    overlap: float,
    scale: float,
    config: VerificationConfig,
    disagreement: ScanDisagreement | None = None,
) -> NDArray[np.float64]:
    """The covariance (6, 6), in a level frame of a scene scale, of what more points do not make better.

    Poses drift within a submap and surfaces are rounded off (docs/decisions/0081); what both places share lies the
    farther from their frames the farther these lie apart. What is seen from one of two views alone pulls the pose: its
    share counts by what there is of it for each part of common surface. And a sensor that looks a little beside the
    direction in which odometry moves it is the farther off the farther the places lie apart. All of it is the same in
    metres for any scene scale. Where the `disagreement` of the scans is known, all but the direction counts by it, and
    the direction is as it says; else all is as large as it was on real drives. Where little is common, what there is
    decides, whatever the sensor: that counts in full.
    """
    share = 1.0 if disagreement is None else _systematic_share(disagreement.surface, config)
    horizontal, vertical = config.systematic_horizontal / scale, config.systematic_vertical / scale
    tilt, yaw = np.radians(config.systematic_tilt), np.radians(config.systematic_yaw)
    drift = share * np.array([horizontal, horizontal, vertical, tilt, tilt, yaw])
    apart = share * float(np.linalg.norm(T_match_query[:3, 3])) * _by_metre(scale, config)
    shift = config.unshared_shift / scale
    pitch, turn = np.radians(config.unshared_tilt), np.radians(config.unshared_yaw)
    parts = (1.0 - overlap) / max(overlap, _LEAST_OVERLAP)
    pulling = share * min(parts, config.unshared_parts) + max(parts - config.unshared_parts, 0.0)
    unshared = pulling * np.array([shift, shift, shift, pitch, pitch, turn])
    away, aside = T_match_query[:3, 3], np.zeros((6, 6))
    aside[:3, :3] = away @ away * np.eye(3) - np.outer(away, away)
    direction = np.radians(config.systematic_direction) if disagreement is None else disagreement.askew
    return np.asarray(np.diag(np.square(drift) + np.square(apart) + np.square(unshared)) + direction**2 * aside)


def _by_metre(scale: float, config: VerificationConfig) -> NDArray[np.float64]:
    """The deviations (6,) for each unit of a scene scale between two places."""
    tilt, yaw = scale * np.radians(config.apart_tilt), scale * np.radians(config.apart_yaw)
    return np.array([*[config.apart_horizontal] * 2, config.apart_vertical, tilt, tilt, yaw])


def frames_covariance(
    T_match_query: se3.Matrix4, query: ScanDisagreement, match: ScanDisagreement, scale: float
) -> NDArray[np.float64]:
    """The covariance (6, 6), in the frame of the match, of what the frames of two submaps are off by themselves.

    T_match_query (4, 4) between the submap frames. A frame is the recorded pose of one scan; all scans together carry
    the surfaces that are aligned, and that one pose is off from them (docs/decisions/0081).
    """
    adjoint = se3.adjoint(T_match_query)
    of_query, of_match = (np.diag(np.square([scale * one.shift] * 3 + [one.turn] * 3)) for one in (query, match))
    return np.asarray(of_match + adjoint @ of_query @ adjoint.T)


def _systematic_share(surface: float, config: VerificationConfig) -> float:
    """Which share of the systematic deviations the disagreement of the scans on their surfaces makes likely."""
    beyond = np.sqrt(max(surface**2 - config.agreeing_surface**2, 0.0))
    return float(np.clip(beyond / config.disagreeing_surface, config.least_systematic, 1.0))


def common_disagreement(query: Place, match: Place) -> ScanDisagreement | None:
    """The root mean square of what the scans of two places disagree by; None where that of either is not known."""
    first, second = query.scan_disagreement, match.scan_disagreement
    if first is None or second is None:
        return None
    return ScanDisagreement(*np.sqrt(0.5 * np.square(astuple(first)) + 0.5 * np.square(astuple(second))).tolist())


def loop_score(overlap: float, contrast: float, seen_through: float, rmse_m: float, inliers: int) -> float:
    """Evidence to 0..1, with weights from real and simulated pairs of submaps (docs/decisions/0018)."""
    few = min(np.log(max(inliers, 1) / _ENOUGH_INLIERS), 0.0)
    features = (1.0, overlap, contrast, seen_through, max(rmse_m, _SHARPEST_RMSE_M), few)
    logit = float(np.dot(_SCORE_WEIGHTS, features))
    return float(1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0))))


_LEAST_OVERLAP = 0.05  # less is no loop
_SCORE_WEIGHTS = (17.7, -8.0, 40.0, -65.0, -150.0, 1.0)
_ENOUGH_INLIERS = 12  # keypoints that agree; more are no better evidence
_SHARPEST_RMSE_M = 0.04  # cleaner surfaces, such as simulated ones, are no better evidence


def _measure(
    fit: KeypointFit, registration: Registration, evidence: Evidence, similarity: float, config: VerificationConfig
) -> LoopMeasurement:
    # neighbouring residuals are not independent, so the information counts one point in `correlated_points`
    variance = max(evidence.rmse_m, config.min_sigma) ** 2 * config.correlated_points
    covariance = variance * np.linalg.inv(evidence.information + 1e-6 * np.eye(6))
    return LoopMeasurement(
        similarity=similarity,
        inliers=fit.inliers,
        inlier_ratio=fit.inliers / max(fit.correspondences, 1),
        overlap=evidence.overlap,
        contrast=evidence.contrast,
        seen_through=evidence.seen_through,
        rmse_m=evidence.rmse_m,
        score=loop_score(evidence.overlap, evidence.contrast, evidence.seen_through, evidence.rmse_m, fit.inliers),
        T_match_query=registration.T_match_query,
        covariance=0.5 * (covariance + covariance.T),
    )


def _unlevelled(
    measurement: LoopMeasurement, query: Place, match: Place, config: VerificationConfig
) -> LoopMeasurement:
    """The measurement between the submap frames instead of the levelled, scaled ones."""
    scale, T_match_query = match.frame.scale, measurement.T_match_query
    covariance = measurement.covariance + systematic_covariance(
        T_match_query, measurement.overlap, scale, config, common_disagreement(query, match)
    )
    covariance = match.frame.covariance_to_submap(covariance)
    T_match_query = motion_between_submaps(T_match_query, query.frame, match.frame)
    if query.scan_disagreement and match.scan_disagreement:
        covariance += frames_covariance(T_match_query, query.scan_disagreement, match.scan_disagreement, scale)
    return dataclasses.replace(
        measurement,
        T_match_query=T_match_query,
        rmse_m=measurement.rmse_m * scale,
        covariance=covariance,
        rivals=tuple(
            Hypothesis(one.overlap, motion_between_submaps(one.T_match_query, query.frame, match.frame))
            for one in measurement.rivals
        ),
    )


def _inverted(verdict: PairVerdict) -> PairVerdict:
    """The same verdict with query and match exchanged."""
    measurement = verdict.measurement
    if measurement is None:
        return verdict
    T_query_match = se3.inverse(measurement.T_match_query)
    adjoint = se3.adjoint(T_query_match)
    covariance = adjoint @ measurement.covariance @ adjoint.T
    exchanged = dataclasses.replace(
        measurement,
        T_match_query=T_query_match,
        covariance=0.5 * (covariance + covariance.T),
        rivals=tuple(Hypothesis(one.overlap, se3.inverse(one.T_match_query)) for one in measurement.rivals),
    )
    return dataclasses.replace(verdict, measurement=exchanged)


def _rejection(
    registration: Registration, evidence: Evidence, score: float, enough: float, config: VerificationConfig
) -> RejectionReason | None:
    """The first gate that the evidence does not pass, or None where it passes all."""
    tilt = float(np.arccos(np.clip(registration.T_match_query[2, 2], -1.0, 1.0)))
    gates = (
        (evidence.common < enough, RejectionReason.NO_COMMON_REGION),
        (
            observability(evidence.information, config.lever) < config.min_observability,
            RejectionReason.DEGENERATE_ALIGNMENT,
        ),
        (tilt > np.radians(config.max_tilt), RejectionReason.IMPLAUSIBLE_TILT),
        (evidence.overlap < config.min_overlap, RejectionReason.LOW_OVERLAP),
        (evidence.contrast < config.min_contrast, RejectionReason.DEGENERATE_ALIGNMENT),
        (evidence.seen_through > config.max_seen_through, RejectionReason.SEEN_THROUGH),
        (score < config.min_score, RejectionReason.LOW_SCORE),
    )
    return next((reason for fails, reason in gates if fails), None)

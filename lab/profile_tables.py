"""The paper's form of the method beside the product's, in the units of the paper's tables (docs/decisions/0122).

`python -m lab.profile_tables OUT DOMAIN [DOMAIN ...]` prints a table for each domain, half of its way:
area under the curve and largest F1 with bootstrap intervals, without a part each (the paper's Table III), by the cosine
as it is (Eq. 15) and standardised by the map; seconds of the processor and bytes of a submap (Tables IV and V).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from lab.command_line import run
from lab.domains.catalogue import DOMAINS, Domain, Pass, Setting
from lab.recognition.experiment import MethodResult, Scores, scores
from revisit.core.config import FusionConfig, PipelineConfig
from revisit.core.descriptor.fusion import without_parts
from revisit.core.index import Match
from revisit.core.profiles import Profile, profile_config
from revisit.evaluation.ablation import Ablation
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import Recording
from revisit.evaluation.described_submaps import DescribedSubmap, DescriptionWork, describe_submap
from revisit.evaluation.ground_truth import GroundTruth
from revisit.evaluation.loop_closure_method import LoopClosureMethod, RevisitMethod
from revisit.evaluation.matching import search_map
from revisit.evaluation.perturbations import Perturbation

Vectors = NDArray[np.float32]

SHARE = 0.5
_KEPT = 5
_RAW_BYTES_PER_POINT = 12


@dataclass(frozen=True)
class Drives:
    """The described submaps of a domain: queries and the map; the same where a drive is its own map."""

    queries: list[DescribedSubmap]
    mapped: list[DescribedSubmap]

    @property
    def own_map(self) -> bool:
        """Whether queries are matched with earlier submaps of their own drive."""
        return self.queries is self.mapped

    def changed(self, change: Callable[[Vectors], Vectors]) -> Drives:
        """The same with other descriptors."""
        queries = [_with_vector(one, change) for one in self.queries]
        return Drives(queries, queries if self.own_map else [_with_vector(one, change) for one in self.mapped])


def described(made: Pass, domain: Domain, profile: Profile, ablation: Ablation) -> Drives:
    """All submaps of a domain by one form of the method."""
    method = RevisitMethod(PipelineConfig(submap=domain.submap), ablation, profile)
    queries = _described(made.queries, made.thinned_queries, domain, method)
    if made.mapped is None:
        return Drives(queries, queries)
    return Drives(queries, _described(made.mapped, made.thinned_map, domain, method))


def plain_candidates(drives: Drives, allowed: NDArray[np.bool_]) -> list[tuple[Match, ...]]:
    """The most similar allowed submaps (q, m) of every query by the cosine as it is (Eq. 15)."""
    similarity = np.where(allowed, _vectors(drives.queries) @ _vectors(drives.mapped).T, -np.inf)
    order = np.argsort(-similarity, axis=1, kind="stable")[:, :_KEPT]
    return [
        tuple(Match(int(row), float(line[row])) for row in best if np.isfinite(line[row]))
        for line, best in zip(similarity, order, strict=True)
    ]


def judged(drives: Drives, domain: Domain, *, standardised: bool) -> Scores:
    """The figures of the descriptors of a domain."""
    queries = np.array([one.position for one in drives.queries])
    truth = (
        GroundTruth.within_session(queries, domain.loops)
        if drives.own_map
        else GroundTruth.between_sessions(
            queries, np.array([one.position for one in drives.mapped]), domain.loops.positive_radius_m
        )
    )
    if standardised:
        found = search_map(drives.queries, drives.mapped, _KEPT, truth.allowed, own_map=drives.own_map)
    else:
        found = plain_candidates(drives, truth.allowed)
    result = MethodResult(
        "descriptor", tuple(tuple(match.id for match in some) for some in found),
        tuple(some[0].similarity if some else None for some in found), 0.0, 0.0, 0.0,
    )  # fmt: skip
    return scores(result, truth)


def variants(domain: Domain, setting: Setting, profile: Profile) -> dict[str, Drives]:
    """The method whole, and without a part each."""
    made = domain.make(setting)
    whole = described(made, domain, profile, Ablation.NONE)
    fusion = profile_config(profile).fusion
    return {
        "whole": whole,
        "without the implicit map": described(made, domain, profile, Ablation.NO_IMPLICIT),
        "without normals": whole.changed(_masked(fusion, normals=True)),
        "without BEV": whole.changed(_masked(fusion, bev=True)),
    }


def table(domain: Domain, setting: Setting) -> Iterator[str]:
    """Lines of the Markdown table of a domain, as they become known."""
    for profile in Profile:
        for name, drives in variants(domain, setting, profile).items():
            cells = [_cell(judged(drives, domain, standardised=standardised)) for standardised in (False, True)]
            yield f"| {domain.name} | {profile.value} | {name} | {cells[0]} | {cells[1]} | {_costs(drives)} |"


def _described(
    recording: Recording, perturbation: Perturbation, domain: Domain, method: LoopClosureMethod
) -> list[DescribedSubmap]:
    work = DescriptionWork(recording, domain.submap, perturbation, method, 0)
    found = [describe_submap(work, task) for task in enumerate(cut(recording, domain.submap))]
    return [one for one in found if one.description is not None]


def _masked(fusion: FusionConfig, *, bev: bool = False, normals: bool = False) -> Callable[[Vectors], Vectors]:
    return lambda vector: without_parts(vector, fusion, bev=bev, normals=normals)


def _with_vector(submap: DescribedSubmap, change: Callable[[Vectors], Vectors]) -> DescribedSubmap:
    if submap.description is None:
        return submap
    return replace(submap, description=replace(submap.description, vector=change(submap.description.vector)))


def _vectors(submaps: Sequence[DescribedSubmap]) -> Vectors:
    return np.array([one.description.vector for one in submaps if one.description is not None])


def _cell(found: Scores) -> str:
    auc, f1 = found.recognition.auc, found.recognition.max_f1
    return f"{auc.value:.3f} [{auc.low:.3f}, {auc.high:.3f}] / {f1.value:.3f} | {found.recall_at_1:.3f}"


def _costs(drives: Drives) -> str:
    """Milliseconds of describing (median), kilobytes of the neural map (mean), and its share of the raw cloud."""
    both = [one for one in drives.mapped if one.description is not None]
    seconds = np.median([sum(one.description.seconds.values()) for one in both if one.description is not None])
    neural = np.mean([one.description.neural_map_bytes for one in both if one.description is not None])
    raw = np.mean([one.points * _RAW_BYTES_PER_POINT for one in both])
    share = f"{neural / 1e3:.1f} | {100 * neural / raw:.2f}" if neural else "- | -"
    return f"{1000 * seconds:.0f} | {share}"


def main(out: Path, names: list[str]) -> None:
    """Print the tables of the domains."""
    torch.set_num_threads(1)
    print("| domain | profile | form | cosine: AUC / F1 | recall@1 | standardised: AUC / F1 | recall@1 | ms | kB | % |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for domain in DOMAINS:
        if domain.name in names and not domain.missing:
            for line in table(domain, Setting(out, SHARE)):
                print(line, flush=True)


if __name__ == "__main__":
    run(main)

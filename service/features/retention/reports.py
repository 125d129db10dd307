"""Reports of retention: what each rule has removed, or would remove."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from revisit.service.domain.retention import Redescription, RetentionPolicy, RetentionRule

SCAN_ROW_BYTES = 573
PAIR_ROW_BYTES = 900
SUBMAP_ROW_BYTES = 4_100
"""Rows with their history and indexes, of a retired submap its descriptor: `docs/reference/measurements.md`. Blobs are
weighed."""


@dataclass(frozen=True)
class RuleOutcome:
    """How much one rule has removed, or would: `bytes` are those of blobs on the disk, and about those of the rows.

    `submaps` are retired, but for the rule SCANS, which leaves them without scans.
    """

    rule: RetentionRule
    sessions: int = 0
    submaps: int = 0
    scans: int = 0
    loop_closures: int = 0
    bytes: int = 0

    def __bool__(self) -> bool:
        """Whether there was anything."""
        return bool(self.sessions or self.submaps or self.scans or self.loop_closures)

    def counts(self) -> dict[str, int]:
        """All of it by name, but for the rule."""
        return {name: count for name, count in asdict(self).items() if name != "rule"}

    def plus(self, **counts: int) -> RuleOutcome:
        """With more of these."""
        return replace(self, **{name: getattr(self, name) + count for name, count in counts.items()})


@dataclass(frozen=True)
class RetentionReport:
    """What a run has removed at a time, or would remove, rule by rule; what is kept although a rule says otherwise.

    `submaps_held` are ends of loops that wait for a decision; `sessions_held` are such that the map rests on, of which
    submaps are retired. `bytes_estimated`: not each blob was weighed.
    """

    at_ns: int
    rules: tuple[RuleOutcome, ...] = ()
    submaps_held: int = 0
    sessions_held: int = 0
    bytes_estimated: bool = False

    def stored(self) -> dict[str, Any]:
        """As JSON."""
        return asdict(self)

    @classmethod
    def of(cls, stored: Mapping[str, Any] | None) -> RetentionReport | None:
        """The inverse of `stored`."""
        if stored is None:
            return None
        rules = tuple(RuleOutcome(**{**one, "rule": RetentionRule(one["rule"])}) for one in stored["rules"])
        return cls(**{**stored, "rules": rules})


@dataclass(frozen=True)
class MapRetention:
    """The policy of a map in force, whether it is its own, and the last run that has removed anything."""

    map_id: str
    policy: RetentionPolicy
    own: bool
    last_run: RetentionReport | None = None

    @property
    def redescription(self) -> Redescription:
        """What a later model can describe the map's submaps from, once the policy has done its work."""
        return self.policy.redescription


@dataclass
class Tally:
    """The outcomes of a run as they grow."""

    rules: dict[RetentionRule, RuleOutcome] = field(default_factory=dict)

    def add(self, rule: RetentionRule, **counts: int) -> None:
        """Count more of a rule."""
        self.rules[rule] = self.rules.get(rule, RuleOutcome(rule)).plus(**counts)

    def outcomes(self) -> tuple[RuleOutcome, ...]:
        """Those of the rules that had anything to do, in the order of the rules."""
        return tuple(self.rules[rule] for rule in RetentionRule if self.rules.get(rule))

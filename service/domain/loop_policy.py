"""An operator's rules for loop closures: the number of candidates to verify, and the conditions of acceptance."""

from __future__ import annotations

from dataclasses import dataclass, fields

from revisit.service.domain import limits

BOUNDS = {
    "candidates": limits.LOOP_CANDIDATES,
    "min_score": limits.MIN_SCORE,
    "min_overlap": limits.MIN_OVERLAP,
    "max_seen_through": limits.MAX_SEEN_THROUGH,
}
"""The bound of each field of a `LoopPolicy`."""


@dataclass(frozen=True)
class LoopPolicy:
    """A map's own rules for loop closures. None stands for the default of the method.

    `candidates`: the submaps most alike that are verified for each new one. The others decide whether a verified
    candidate is accepted: `min_score` and `min_overlap` are the least values, `max_seen_through` the largest, each 0 to
    1 (see the parameters of the same names of `core.config.VerificationConfig`).
    """

    candidates: int | None = None
    min_score: float | None = None
    min_overlap: float | None = None
    max_seen_through: float | None = None

    def validated(self) -> LoopPolicy:
        """Itself. Raises BadField where a value is out of its bounds."""
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None:
                BOUNDS[field.name].validated(value, f"loop_policy.{field.name}")
        return self

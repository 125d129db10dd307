"""The policy of retention of a map, and its last run, in the map's row."""

from __future__ import annotations

from revisit.service.domain.policy import Policy
from revisit.service.domain.records import MapRecord
from revisit.service.features.retention.reports import MapRetention, RetentionReport


def retention_of(record: MapRecord, rules: Policy) -> MapRetention:
    """The policy of a map as clients see it."""
    last_run = RetentionReport.of(record.retention_run)
    return MapRetention(record.map_id, rules.kept_of(record), record.retention is not None, last_run)

"""What a gateway tells under /metrics, by series; what PromQL asks for."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import httpx
import promql_parser
from prometheus_client.parser import text_string_to_metric_families

from tests.support.patience import PATIENCE_S


def scrape(service) -> str:
    """The text of the metrics of a running gateway."""
    port = service.wait_for("metrics_listening")["port"]
    return httpx.get(f"http://127.0.0.1:{port}/metrics", trust_env=False, timeout=PATIENCE_S).text


def families(text: str) -> set[str]:
    """The names of the families, counters without `_total`."""
    return {family.name for family in text_string_to_metric_families(text) if not family.name.endswith("_created")}


def values_by_label(texts) -> dict[str, dict[str, set[str]]]:
    """Name of a series -> label -> its values."""
    told: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for family in (family for text in texts for family in text_string_to_metric_families(text)):
        for sample in family.samples:
            labels = told[sample.name]
            for label, value in sample.labels.items():
                labels[label].add(value)
    return told


@dataclass(frozen=True)
class Asked:
    """What a query asks of one metric: conditions on labels, as (label, operator, value)."""

    name: str
    conditions: tuple[tuple[str, str, str], ...]


def asked_by(query: str) -> tuple[list[Asked], set[str]]:
    """What a query selects, and the labels that it groups by. Raises ValueError for one that is no PromQL."""
    nodes: list = []
    promql_parser.walk(promql_parser.parse(query), nodes.append)
    selected = [node for node in nodes if isinstance(node, promql_parser.VectorSelector)]
    grouped = [node.modifier for node in nodes if isinstance(node, promql_parser.AggregateExpr) and node.modifier]
    return [Asked(node.name, _conditions(node)) for node in selected], {name for by in grouped for name in by.labels}


def _conditions(node) -> tuple[tuple[str, str, str], ...]:
    return tuple((by.name, str(by.op).rpartition(".")[2], by.value) for by in node.matchers.matchers)

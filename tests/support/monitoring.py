"""The files for Prometheus and Grafana, as what is asked in them."""

from __future__ import annotations

import json

import yaml

from tests.support.processes import ROOT

FOLDER = ROOT / "docker/monitoring"
RULES = yaml.safe_load((FOLDER / "alerts.yaml").read_text())["groups"][0]["rules"]
DASHBOARD = json.loads((FOLDER / "dashboard.json").read_text())


def queries() -> dict[str, str]:
    """Every query, under the name of its alert or the title of its panel."""
    alerts = {rule["alert"]: rule["expr"] for rule in RULES}
    panels = {
        f"{panel['title']} {target['refId']}": target["expr"]
        for panel in DASHBOARD["panels"]
        for target in panel.get("targets", ())
    }
    return {**alerts, **panels}

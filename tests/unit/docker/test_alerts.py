"""The alert rules, run by promtool: each fires on made-up series of its fault, none on those of a sound service."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import pytest

from tests.support.monitoring import FOLDER, RULES
from tests.support.processes import ROOT

PAGE = (ROOT / "docs/how-to/when-a-part-is-lost.md").read_text()
OF = 'job="revisit", instance="a:9464"'

SOUND = {
    "up": "1x120",
    "revisit_workers": "2x120",
    "revisit_jobs_begun_again": "0 1 0x118",
    'revisit_processes{role="search"}': "2x120",
    "revisit_oldest_queued_job_seconds": "0+1x120",
    'revisit_jobs{state="FAILED"}': "7x120",
    'revisit_worker_ends_total{end="killed"}': "0+0.1x120",
    'revisit_worker_ends_total{end="stopped"}': "0+5x120",
    'revisit_refused_calls_total{reason="RATE"}': "0+6x120",
    'revisit_refused_calls_total{reason="NOT_FOUND"}': "0+600x120",
    'revisit_refused_calls_total{reason="DATA_LOSS"}': "2x120",
    'revisit_refused_calls_total{reason="STORAGE_UNCERTAIN"}': "2x120",
    'revisit_event_loop_lag_seconds_bucket{le="0.01"}': "0+1199x120",
    'revisit_event_loop_lag_seconds_bucket{le="1.0"}': "0+1200x120",
    'revisit_event_loop_lag_seconds_bucket{le="+Inf"}': "0+1200x120",
    "revisit_process_open_fds": "60x120",
    "revisit_process_max_fds": "1024x120",
    "revisit_process_start_time_seconds": "0x60 3600x60",
    "revisit_storage_full": "0x120",
    "revisit_disk_free_bytes": "4e12-1e9x120",
    "revisit_quarantined_blobs": "0x120",
    "revisit_blobs_unreachable": "0x120",
    "revisit_index_drift_total": "3x120",
    "revisit_wal_bytes": "4e6x120",
    "revisit_clock_seconds": "0+60x120",
    "revisit_certificate_expiry_seconds": "5e6x120",
}
"""Series of two hours, a value a minute."""

FAULTS = {
    "RevisitGatewayDown": {"up": "0x120"},
    "RevisitGatewayRestarts": {"revisit_process_start_time_seconds": "0+60x120"},
    "RevisitNoWorker": {"revisit_workers": "0x120"},
    "RevisitWorkersDie": {'revisit_worker_ends_total{end="killed"}': "0+1x120"},
    "RevisitRunsAreLost": {"revisit_jobs_begun_again": "1x120"},
    "RevisitSearchIsMissing": {'revisit_processes{role="search"}': "2x80 1x40"},
    "RevisitBacklogIsOld": {"revisit_oldest_queued_job_seconds": "0+60x120"},
    "RevisitCallsAreRefused": {'revisit_refused_calls_total{reason="WORKERS_BUSY"}': "0+60x120"},
    "RevisitDeadLetters": {'revisit_jobs{state="FAILED"}': "7x80 8x40"},
    "RevisitAnswersAreSlow": {'revisit_event_loop_lag_seconds_bucket{le="0.01"}': "0+900x120"},
    "RevisitFilesRunOut": {"revisit_process_open_fds": "1000x120"},
    "RevisitStorageIsFull": {"revisit_storage_full": "0x60 1x60"},
    "RevisitDiskFillsUp": {"revisit_disk_free_bytes": "4e12-1e10x120"},
    "RevisitDataIsDamaged": {"revisit_quarantined_blobs": "1x120"},
    "RevisitDatabaseIsOutOfReach": {"revisit_workers": "2x60 _x60"},
    "RevisitBlobsAreOutOfReach": {"revisit_blobs_unreachable": "1x120"},
    "RevisitIndexDrifts": {"revisit_index_drift_total": "3x80 4x40"},
    "RevisitLogOfDatabaseGrows": {"revisit_wal_bytes": "1e8x120"},
    "RevisitStoreFails": {'revisit_refused_calls_total{reason="STORAGE_UNCERTAIN"}': "2x110 3x10"},
    "RevisitClockIsWrong": {"revisit_clock_seconds": "-3600+60x120"},
    "RevisitCertificateExpires": {"revisit_certificate_expiry_seconds": "1.2e6x120"},
}
"""Alert -> what is different then."""

needs_promtool = pytest.mark.skipif(shutil.which("promtool") is None, reason="promtool is not installed")


def labelled(series):
    """The series with the labels of a scrape."""
    name, _, labels = series.rstrip("}").partition("{")
    return f"{name}{{{', '.join(part for part in (labels, OF) if part)}}}"


def fired(folder, series):
    """The alerts that fire after two hours; promtool tells them by what it did not expect."""
    given = [{"series": labelled(name), "values": values} for name, values in series.items()]
    asked = [{"eval_time": "118m", "alertname": rule["alert"], "exp_alerts": []} for rule in RULES]
    tests = [{"interval": "1m", "input_series": given, "alert_rule_test": asked}]
    (folder / "tests.yaml").write_text(json.dumps({"rule_files": [str(FOLDER / "alerts.yaml")], "tests": tests}))
    done = subprocess.run(["promtool", "test", "rules", str(folder / "tests.yaml")], capture_output=True, text=True)
    told = done.stdout + done.stderr
    assert (done.returncode == 0) == ("FAILED" not in told), told
    return set(re.findall(r'alertname="(\w+)"', told))


@needs_promtool
def test_prometheus_takes_the_rules_and_the_scrape_configuration():
    checks = (("rules", "alerts.yaml"), ("config", "prometheus.yaml"))
    for kind, file in checks:
        done = subprocess.run(["promtool", "check", kind, str(FOLDER / file)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


@needs_promtool
def test_no_alert_fires_over_a_sound_service(tmp_path):
    assert fired(tmp_path, SOUND) == set()


@needs_promtool
@pytest.mark.parametrize("alert", FAULTS)
def test_an_alert_fires_on_its_fault_and_alone(tmp_path, alert):
    assert fired(tmp_path, {**SOUND, **FAULTS[alert]}) == {alert}


def test_every_alert_has_a_fault_that_it_is_tried_on():
    assert [rule["alert"] for rule in RULES] == list(FAULTS)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule["alert"])
def test_an_alert_says_what_is_wrong_and_leads_to_what_to_do(rule):
    anchors = {re.sub(r"\s", "-", title.lower()) for title in re.findall(r"^## (.+)$", PAGE, re.MULTILINE)}
    assert rule["annotations"]["summary"]
    assert rule["annotations"]["runbook"] in anchors
    assert rule["labels"]["severity"] in ("page", "ticket")

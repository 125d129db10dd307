"""The files for several hosts: what a cluster and Compose take, what the service knows, and how little a pod may do."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
import yaml

from revisit.service.__main__ import _parser
from revisit.service.rest.middleware import HEALTH_PATHS
from revisit.service.settings import ForTests, Settings
from revisit.service.settings_loading import load_settings
from tests.support.processes import ROOT

FOLDER = ROOT / "docker/kubernetes"
COMPOSE_FILES = (ROOT / "docker/compose.yaml", ROOT / "docker/compose-hosts.yaml")
RELEASES = ("1.30", "1.37")
"""Releases of Kubernetes that the manifests are held against."""

FILES = sorted(path for path in FOLDER.glob("*.yaml") if path.name != "kustomization.yaml")
MANIFESTS = [part for path in FILES for part in yaml.safe_load_all(path.read_text())]
NAMES = [f"{part['kind']} {part['metadata']['name']}" for part in MANIFESTS]
PODS = {
    f"{part['kind']} {part['metadata']['name']}": part["spec"]["template"]
    for part in MANIFESTS
    if "template" in part.get("spec", {})
}
HOSTS = yaml.safe_load((ROOT / "docker/compose-hosts.yaml").read_text())["services"]
OWN = ("migration", "gateway", "worker", "search")
"""The services of the product; the other one is PostgreSQL."""

DOCKERFILE = (ROOT / "docker/Dockerfile").read_text()
pods = pytest.mark.parametrize("pod", PODS.values(), ids=PODS.keys())


def of_kind(kind):
    return [part for part in MANIFESTS if part["kind"] == kind]


def container(pod):
    (only,) = pod["spec"]["containers"]
    return only


@pytest.mark.parametrize("release", RELEASES)
@pytest.mark.parametrize("manifest", MANIFESTS, ids=NAMES)
def test_a_manifest_is_one_that_kubernetes_takes(manifest, release):
    import kubernetes_validate  # its grammars take longer to build than the rest of this file to run

    kubernetes_validate.validate(manifest, release, strict=True)


def test_all_manifests_are_applied_and_the_secret_is_a_copy_of_the_example():
    applied = yaml.safe_load((FOLDER / "kustomization.yaml").read_text())["resources"]
    assert {name.replace("secret.yaml", "secret.example.yaml") for name in applied} == {path.name for path in FILES}
    ignored = subprocess.run(["git", "check-ignore", "-q", "docker/kubernetes/secret.yaml"], cwd=ROOT, check=False)
    assert ignored.returncode == 0


@pods
def test_a_pod_may_do_little(pod):
    spec, runs = pod["spec"], container(pod)
    user = int(re.search(r"^USER (\d+):", DOCKERFILE, re.MULTILINE)[1])
    whole = spec["securityContext"]
    assert (whole["runAsNonRoot"], whole["runAsUser"], whole["runAsGroup"]) == (True, user, user)
    assert whole["seccompProfile"] == {"type": "RuntimeDefault"}
    assert spec["automountServiceAccountToken"] is False
    assert runs["securityContext"] == {
        "allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]},
    }  # fmt: skip
    assert {"cpu", "memory"} <= runs["resources"]["requests"].keys() and "memory" in runs["resources"]["limits"]


@pods
def test_a_pod_writes_where_the_image_does(pod):
    volume = re.search(r"^VOLUME (\S+)", DOCKERFILE, re.MULTILINE)[1]
    assert {mount["mountPath"] for mount in container(pod)["volumeMounts"]} == {volume, "/tmp"}
    assert all("sizeLimit" in volume["emptyDir"] for volume in pod["spec"]["volumes"])


@pods
def test_a_pod_runs_a_command_of_the_service_in_the_image_of_this_version(pod):
    version = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)[1]
    assert container(pod)["image"].endswith(f":{version}")
    assert container(pod)["command"][:3] == ["python", "-m", "revisit.service"]
    assert _parser().parse_args(container(pod)["command"][3:])


def variables():
    """Every REVISIT_* variable that the files set."""
    config = [name for part in of_kind("ConfigMap") for name in part["data"]]
    secret = [name for part in of_kind("Secret") for name in part["stringData"]]
    own = [entry["name"] for pod in PODS.values() for entry in container(pod).get("env", ())]
    composed = [name for service in OWN for name in HOSTS[service].get("environment", {})]
    return {name for name in (*config, *secret, *own, *composed) if name.startswith("REVISIT_")}


def test_every_variable_of_the_files_is_a_setting():
    assert {name.removeprefix("REVISIT_").lower() for name in variables()} <= Settings.model_fields.keys()


@pytest.mark.parametrize("files", ["pods", "hosts"])
def test_gateways_behind_a_balancer_know_the_names_that_clients_use(files, monkeypatch):
    told = of_kind("ConfigMap")[0]["data"] if files == "pods" else HOSTS["gateway"]["environment"]
    for name in ("REVISIT_ALLOWED_HOSTS", "REVISIT_GRPC_ADDRESS"):
        assert told[name]
        monkeypatch.setenv(name, re.sub(r"^\$\{\w+:-\}$", "", told[name]))
    assert load_settings()  # as delivered, too


def test_the_settings_of_the_pods_are_taken_by_the_service(monkeypatch):
    (config,), (secret,) = of_kind("ConfigMap"), of_kind("Secret")
    for name, value in {**config["data"], **secret["stringData"], "REVISIT_SECRET": "0" * 64}.items():
        monkeypatch.setenv(name, value)
    settings = load_settings()
    assert settings.exposed and settings.credential_required and settings.metrics_port == 9464


def test_a_gateway_has_the_time_to_drain():
    spec = PODS["Deployment revisit-gateway"]["spec"]
    pause_s = int(container(PODS["Deployment revisit-gateway"])["lifecycle"]["preStop"]["exec"]["command"][1])
    assert spec["terminationGracePeriodSeconds"] > pause_s + ForTests().drain_s


def test_probes_ask_for_health_where_the_gateway_listens():
    runs = container(PODS["Deployment revisit-gateway"])
    ports = {port["name"]: port["containerPort"] for port in runs["ports"]}
    assert ports["http"] == Settings.model_fields["http_port"].default
    assert ports["grpc"] == Settings.model_fields["grpc_port"].default
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        assert runs[probe]["httpGet"]["path"] in HEALTH_PATHS and runs[probe]["httpGet"]["port"] == "http"


def test_services_budgets_and_policies_choose_pods_that_there_are():
    labels = [pod["metadata"]["labels"] for pod in PODS.values()]
    chosen = [part["spec"]["selector"] for part in of_kind("Service")]
    chosen += [part["spec"]["selector"]["matchLabels"] for part in of_kind("PodDisruptionBudget")]
    chosen += [part["spec"]["podSelector"].get("matchLabels", {}) for part in of_kind("NetworkPolicy")]
    for wanted in chosen:
        assert any(wanted.items() <= own.items() for own in labels), wanted


def test_nothing_reaches_a_pod_that_is_not_said_to():
    (nothing,) = [part for part in of_kind("NetworkPolicy") if part["spec"]["podSelector"] == {}]
    assert nothing["spec"] == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    doors = [rule for part in of_kind("NetworkPolicy") for rule in part["spec"].get("ingress", ())]
    assert doors and all(rule["from"] and rule["ports"] for rule in doors)


def test_workers_fit_into_the_memory_of_their_pod():
    runs = container(PODS["Deployment revisit-worker"])
    own = {entry["name"]: int(entry["value"]) for entry in runs["env"]}
    most_mb = own["REVISIT_WORKERS"] * own["REVISIT_WORKER_MEMORY_MB"]
    assert most_mb < 1024 * int(runs["resources"]["limits"]["memory"].removesuffix("Gi")) <= most_mb + 2048


def test_workers_follow_the_age_of_the_oldest_job():
    (scaler,) = of_kind("HorizontalPodAutoscaler")
    name = scaler["spec"]["metrics"][0]["external"]["metric"]["name"]
    assert f"## {name}\n" in (ROOT / "docs/reference/metrics.md").read_text()
    assert f"Deployment {scaler['spec']['scaleTargetRef']['name']}" in PODS


def test_compose_files_are_such_as_compose_takes():
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec"]
    command += [str(file) for file in COMPOSE_FILES]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("name", OWN)
def test_a_service_of_several_hosts_is_locked_down_and_runs_a_command_of_the_service(name):
    service = HOSTS[name]
    assert (service["read_only"], service["cap_drop"]) == (True, ["ALL"])
    assert service["security_opt"] == ["no-new-privileges:true"] and "mem_limit" in service
    command = service.get("command", ["python", "-m", "revisit.service", "serve"])
    assert command[:3] == ["python", "-m", "revisit.service"] and _parser().parse_args(command[3:])


@pytest.mark.parametrize("name", ["gateway", "postgres"])
def test_ports_of_several_hosts_are_open_on_one_address(name):
    assert all(port.startswith("${ADDRESS:?}:") for port in HOSTS[name]["ports"])

"""Pinned versions stay above known vulnerabilities, and the gateway stays light."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name
from packaging.version import Version

from tests.support.requirements import PLATFORMS, direct, distributions, everything

ROOT = Path(__file__).resolve().parents[2]
CONSTRAINTS = (ROOT / "constraints.txt").read_text().splitlines()
PINS = {canonicalize_name(line.partition("==")[0]): line.partition("==")[2] for line in CONSTRAINTS}
SHIPPED = ("core", "service", "evaluation", "migrations", "revisit")
DECLARED = list(everything("dev"))

# Lowest versions without the vulnerabilities named.
FLOORS = {
    "starlette": "1.3.1",  # CVE-2025-54121, CVE-2025-62727, CVE-2026-48710
    "fastapi": "0.109.1",  # CVE-2024-24762
    "uvicorn": "0.11.7",  # CVE-2020-7694
    "h11": "0.16",  # CVE-2025-43859
    "grpcio": "1.65.4",  # CVE-2023-1428, CVE-2023-33953, CVE-2024-7246
    "protobuf": "6.31.1",  # CVE-2025-4565
    "torch": "2.10",  # CVE-2025-32434, CVE-2026-24747
    "opencv-python-headless": "4.12",  # CVE-2025-53644
}


# Distributions whose module has another name.
MODULES = {
    "faiss-cpu": "faiss",
    "googleapis-common-protos": "google.rpc",
    "grpcio": "grpc",
    "grpcio-health-checking": "grpc_health",
    "grpcio-reflection": "grpc_reflection",
    "open3d-cpu": "open3d",
    "opencv-python-headless": "cv2",
    "opentelemetry-exporter-otlp-proto-grpc": "opentelemetry.exporter.otlp.proto.grpc",
    "opentelemetry-sdk": "opentelemetry.sdk",
    "protobuf": "google.protobuf",
    "pyjwt": "jwt",
}


def modules(extra: str) -> set[str]:
    """The modules that the libraries of an extra are imported by."""
    names = {canonicalize_name(requirement.name) for requirement in direct(extra)}
    return {MODULES.get(name, name.replace("-", "_")) for name in names}


@pytest.mark.parametrize("name", FLOORS)
def test_pins_and_requirements_are_above_known_vulnerabilities(name):
    assert Version(PINS[name]) >= Version(FLOORS[name])
    for requirement in DECLARED:
        if requirement.name == name:
            below = f"{Version(FLOORS[name]).major}.0.0" if Version(FLOORS[name]).minor else "0.0.1"
            assert not requirement.specifier.contains(below)


def test_multipart_is_absent_because_bodies_are_raw():
    assert Version(PINS.get("python-multipart", "0.0.31")) >= Version("0.0.31")
    assert "python-multipart" not in PINS


def test_every_pin_is_one_plain_public_version():
    for line in CONSTRAINTS:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9a-z.]*", line), line


def test_every_direct_dependency_is_pinned():
    names = {canonicalize_name(requirement.name) for requirement in DECLARED}
    # The second line of the Open3D pair is for other platforms than the tested one.
    assert names - PINS.keys() <= {"open3d"}


def test_nothing_is_pinned_that_no_installation_holds():
    assert PINS.keys() - distributions("dev").union(*(distributions("dev", where) for where in PLATFORMS)) == set()


def test_pins_satisfy_the_requirements():
    for requirement in DECLARED:
        pin = PINS.get(canonicalize_name(requirement.name))
        assert pin is None or requirement.specifier.contains(pin), requirement


@pytest.mark.parametrize("library", sorted(modules("") | modules("evaluation")))
def test_every_library_that_is_asked_for_is_imported(library):
    pattern = rf"(?m)^\s*(?:from|import) {re.escape(library)}\b"
    sources = [path for folder in SHIPPED for path in (ROOT / folder).rglob("*.py")]
    assert any(re.search(pattern, path.read_text()) for path in sources)


def test_the_contract_of_the_sdk_forbids_every_library_of_the_extras():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (sdk,) = [contract for contract in contracts if contract["name"].startswith("The SDK needs")]
    libraries = {library.partition(".")[0] for library in modules("evaluation") - modules("")}
    assert libraries - set(sdk["forbidden_modules"]) == set()
    assert {"torch", "matplotlib", "typer"} <= libraries


@pytest.mark.parametrize("gateway", ["revisit.service.rest.app", "revisit.service.grpc.server"])
def test_the_gateway_imports_no_heavy_library(gateway):
    if importlib.util.find_spec(gateway.rpartition(".")[0]) is None or importlib.util.find_spec(gateway) is None:
        pytest.fail(f"{gateway} does not exist")
    code = f"import sys, {gateway}; print(*sorted({{'torch', 'open3d', 'sklearn', 'cv2'}} & sys.modules.keys()))"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.split() == []


def test_no_committed_file_names_a_machine_or_a_package_index():
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.split(b"\0")
    pattern = re.compile(rb"/wor[k]/(?:main|shared)|/root/|--(?:extra-)?index-url|--find-links")
    this = Path(__file__).resolve()
    paths = [ROOT / name.decode() for name in tracked if name]
    found = [path for path in paths if path.is_file() and path != this and pattern.search(path.read_bytes())]
    assert not found

"""The container files follow the rules of the house, read as text: no daemon is needed."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from revisit.service.settings import Settings

ROOT = Path(__file__).resolve().parents[3]
DOCKERFILE = (ROOT / "docker/Dockerfile").read_text()
COMPOSE = (ROOT / "docker/compose.yaml").read_text()
TARGETS = ("gateway", "worker")


def instructions(text):
    """(instruction, arguments) pairs, continued lines joined, comments left out."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines))
    return [tuple(line.split(None, 1)) for line in joined.splitlines()]


def stages(text):
    """name -> (image it starts from, its instructions)."""
    found = {}
    for word, rest in instructions(text):
        if word == "FROM":
            image, _, name = rest.partition(" AS ")
            found[name] = (image, current := [])
        elif found:
            current.append((word, rest))
    return found


STAGES = stages(DOCKERFILE)


def own_and_inherited(name):
    image, steps = STAGES[name]
    return [*(own_and_inherited(image) if image in STAGES else []), *steps]


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_runs_as_a_user_that_is_not_root(target):
    users = [rest for word, rest in own_and_inherited(target) if word == "USER"]
    assert users[-1] == "10001:10001"


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_has_a_health_check_and_a_command_that_gets_its_signals(target):
    _, steps = STAGES[target]
    assert [word for word, _ in steps].count("HEALTHCHECK") == 1
    command = json.loads(dict(steps)["CMD"])
    assert command[0] == "python" or (command[:2] == ["sh", "-c"] and command[2].startswith("exec "))


def test_all_stages_begin_with_one_base_of_a_full_version_for_which_a_build_may_name_a_digest():
    arguments = dict(rest.split("=", 1) for word, rest in instructions(DOCKERFILE) if word == "ARG")
    assert re.fullmatch(r"python:3\.\d+\.\d+-slim-bookworm", arguments["BASE"])
    assert {image for image, _ in STAGES.values() if image not in STAGES} == {"${BASE}"}
    # Only what stands before the first stage can be named in FROM.
    assert instructions(DOCKERFILE)[0][0] == "ARG"


@pytest.mark.parametrize("target", TARGETS)
def test_compiled_kernels_are_kept_on_the_volume(target):
    steps = own_and_inherited(target)
    (folder,) = [
        re.search(r"NUMBA_CACHE_DIR=(\S+)", rest)[1] for word, rest in steps if word == "ENV" and "NUMBA" in rest
    ]
    (volume,) = [rest for word, rest in steps if word == "VOLUME"]
    assert Path(volume) in Path(folder).parents
    assert f"volumes: [data:{volume}]" in compose_service(target)


def test_nothing_is_added_from_elsewhere():
    assert "ADD" not in [word for word, _ in instructions(DOCKERFILE)]
    assert not re.search(
        r"curl|wget|https?://(?!127\.0\.0\.1)", "\n".join(rest for _, rest in instructions(DOCKERFILE))
    )


def test_all_that_is_copied_exists_and_is_let_through():
    ignored = (ROOT / ".dockerignore").read_text().splitlines()
    copied = [rest for word, rest in instructions(DOCKERFILE) if word == "COPY" and not rest.startswith("--from")]
    for source in " ".join(rest.rpartition(" ")[0] for rest in copied).split():
        # `*` at the end: the file may be missing.
        assert source.endswith("*") or (ROOT / source).exists(), source
        assert f"!{Path(source.removesuffix('*'))}" in ignored


def test_every_folder_that_is_linked_into_the_package_is_copied_beside_it():
    linked = {path.readlink().name for path in (ROOT / "revisit").iterdir() if path.is_symlink()}
    assert linked == {"core", "service", "evaluation", "migrations"}
    assert linked <= {rest.split()[0] for word, rest in instructions(DOCKERFILE) if word == "COPY"}


def test_the_image_holds_what_the_service_needs_and_further_extras_only_where_they_are_asked_for():
    (command,) = [rest for word, rest in instructions(DOCKERFILE) if "pip install" in rest]
    assert re.search(r'-c constraints.txt "\.\[\$EXTRAS\]"', command)
    assert ("ARG", "EXTRAS=service") in instructions(DOCKERFILE)


def compose_service(name):
    """The text of a service, with what it merges in; no YAML parser is among the project's dependencies."""
    own = re.search(rf"^  {name}:\n((?:    .*\n|\n)+)", COMPOSE, re.MULTILINE)[1]
    shared = re.search(r"^x-service: &service\n((?:  .*\n)+)", COMPOSE, re.MULTILINE)[1]
    return own + (shared if "<<: *service" in own else "")


@pytest.mark.parametrize("name", TARGETS)
@pytest.mark.parametrize(
    "line",
    [
        "read_only: true",
        "cap_drop: [ALL]",
        "volumes: [data:/data]",
        'security_opt: ["no-new-privileges:true"]',
        "pids_limit: 256",
        'tmpfs: ["/tmp:size=64m,mode=1777,nosuid,nodev,noexec"]',
    ],
)
def test_the_services_are_locked_down_and_share_one_volume(name, line):
    assert line in compose_service(name)


@pytest.mark.parametrize("name", TARGETS)
def test_a_service_may_take_more_memory_than_its_workers_and_not_all_there_is(name):
    limit_mb = 1024 * int(re.search(r"mem_limit: (\d+)g", compose_service(name))[1])
    assert Settings.model_fields["worker_memory_mb"].default < limit_mb <= 8 * 1024


@pytest.mark.parametrize("name", TARGETS)
def test_a_service_builds_its_target_under_the_version_of_the_project(name):
    version = re.search(r'^version = "(.+)"', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)[1]
    service = compose_service(name)
    assert f"target: {name}}}" in service
    assert re.search(r"image: (\S+)", service)[1].endswith(f":{version}")


def test_the_ports_are_published_on_this_machine_only():
    ports = re.findall(r'"([\d.:]+:\d+)"', re.search(r"ports: (.*)", COMPOSE)[1])
    assert len(ports) == 2
    assert all(port.startswith("127.0.0.1:") for port in ports)


def test_a_container_that_stops_leaves_jobs_their_time():
    assert int(re.search(r"stop_grace_period: (\d+)s", COMPOSE)[1]) >= 15


def test_the_systemd_unit_starts_a_command_that_the_service_has():
    printed = subprocess.run(
        [sys.executable, "-m", "revisit.service", "unit"], cwd=ROOT, capture_output=True, check=True, text=True
    )
    unit = printed.stdout
    assert f"ExecStart={sys.executable} " in unit and "WantedBy=multi-user.target" in unit
    module, command = re.search(r"^ExecStart=\S+/python -P -m (\S+) (\S+)$", unit, re.MULTILINE).groups()
    done = subprocess.run([sys.executable, "-m", module, command, "--help"], cwd=ROOT, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def variables(steps):
    """What the ENV instructions of a target set for the service."""
    pairs = (pair.split("=", 1) for word, rest in steps if word == "ENV" for pair in rest.split())
    return {name: value for name, value in pairs if name.startswith("REVISIT_")}


def test_the_image_by_itself_lets_nobody_in_without_a_credential(monkeypatch):
    for name, value in variables(own_and_inherited("gateway")).items():
        monkeypatch.setenv(name, value)
    settings = Settings()
    assert (settings.exposed, settings.credential_required) == (True, True)


def test_only_a_gateway_that_this_machine_alone_can_reach_is_open_without_a_key():
    gateway = COMPOSE[COMPOSE.index("  gateway:") : COMPOSE.index("  worker:")]
    published = re.findall(r'"([^"]*:\d+:\d+)"', gateway)
    assert published and all(port.startswith("127.0.0.1:") for port in published)
    assert "REVISIT_AUTHENTICATION: auto" in gateway and "REVISIT_AUTHENTICATION" not in COMPOSE.replace(gateway, "")

"""The SDK as a robot installs it: from a wheel, beside nothing but its own dependencies, in somebody else's project."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from contextlib import closing
from importlib import metadata
from pathlib import Path

import pytest

from revisit.evaluation.datasets import write_kitti
from tests.support.live_service import live_service
from tests.support.patience import in_time
from tests.support.processes import ServiceProcess
from tests.support.requirements import PROJECT, ROOT, distributions
from tests.support.service_world import cloud_points, pose

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links the dependencies into a new environment")

IMPORT_CPU_S = 0.5

COPIED = {"opencv-python-headless"}
"""Distributions that follow links to their own files and then load from there."""

# A robot's own project, whose packages have the names of our folders.
OWN = ("core", "service", "evaluation", "migrations")

LOADED = """
import json, os, sys, time
begun = time.process_time()
from revisit import Client
took_s = time.process_time() - begun
import core, evaluation, migrations, service
import revisit.core.errors
modules = sorted({name.partition(".")[0] for name in sys.modules})
print(json.dumps({"took_s": took_s, "modules": modules, "core": core.__file__, "service": service.__file__,
                  "revisit": revisit.__file__}))
"""

POSTED = """
import sys
import numpy as np
from revisit import Client
points = np.random.default_rng(1).uniform(-10.0, 10.0, (5000, 3)).astype(np.float32)
with Client(sys.argv[1]) as client:
    client.create_map("yard")
    session = client.create_session("maps/yard", "drive")
    client.post_submap(session, "gate", points, np.eye(4), 1)
with Client.grpc(sys.argv[2]) as client:
    print([submap.name for submap in client.list_submaps(session)])
    with client.stream(client.create_session("maps/yard", "streamed")) as stream:
        stream.send(points, np.eye(4), 2)
        stream.flush()
print(sorted({"torch", "scipy", "numba", "fastapi"} & sys.modules.keys()))
"""

ASKED = """
import sys
import numpy as np
from revisit import Client
from revisit.formats import decode_cloud, encode_npy
points = np.random.default_rng(1).uniform(-10.0, 10.0, (5000, 3)).astype(np.float32)
with Client(sys.argv[1]) as client:
    session = client.create_session("yard", "again")
    client.wait(client.post_submap(session, "gate", points, np.eye(4), 3))
    loops = client.loop_closures("yard", session=session)
    print([loop.query for loop in loops][:1])
    print(loops[0].T_match_query.shape, loops[0].T_match_query.dtype)
    stored = decode_cloud(client.download(loops[0].query, "npy"), "application/vnd.npy").points
    client.localize("yard", points, T_level_query=np.eye(4))
    print(len(client.search("yard", points=points, k=2)) > 0 and stored.shape[1] == 3)
"""


METHOD = "revisit.service.adapters.core_recogniser:load_recogniser"


class InstalledService(ServiceProcess):
    """The service of an environment, started in somebody else's project, with its own models."""

    def __init__(self, environment: Path, project: Path, home: Path) -> None:
        self.python = (str(environment / "bin/python"),)
        self.folder = project
        super().__init__(home, recogniser=METHOD)


def checkout(folder: Path) -> Path:
    """The files of the working tree that are or would be committed, links as links."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        source, target = ROOT / name, folder / name
        if name.startswith(("tests/", "docs/")) or not (source.is_symlink() or source.is_file()):
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_symlink():
            target.symlink_to(source.readlink())
        else:
            target.write_bytes(source.read_bytes())
    return folder


def built(kind: str, source: Path, folder: Path) -> Path:
    """The wheel or sdist that setuptools makes of a source tree, without any network."""
    code = f"import setuptools.build_meta as build; print(build.build_{kind}({str(folder)!r}))"
    folder.mkdir(exist_ok=True)
    return folder / run([sys.executable, "-c", code], source).stdout.splitlines()[-1]


def run(command: list[str], cwd: Path, status: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(command, cwd=cwd, env=clean(), capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    return done


def clean() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "REVISIT_"))}


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    return checkout(tmp_path_factory.mktemp("source"))


@pytest.fixture(scope="module")
def wheel(source, tmp_path_factory) -> Path:
    return built("wheel", source, tmp_path_factory.mktemp("wheels"))


@pytest.fixture(scope="module")
def unpacked(source, tmp_path_factory) -> Path:
    """The sdist, unpacked."""
    archive = built("sdist", source, tmp_path_factory.mktemp("sdist"))
    folder = tmp_path_factory.mktemp("unpacked")
    with tarfile.open(archive) as opened:
        opened.extractall(folder, filter="data")
    (top,) = folder.iterdir()
    return top


def installed(wheel: Path, folder: Path, names: set[str]) -> Path:
    """A virtual environment of a wheel and of distributions that are linked file by file: no network."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    link(names, site)
    command = [sys.executable, "-m", "pip", "--isolated", "--python", str(folder / "bin/python"), "install"]
    run([*command, "--quiet", "--no-index", "--no-deps", str(wheel)], folder)
    return folder


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory) -> Path:
    """The wheel and the base dependencies alone."""
    return installed(wheel, tmp_path_factory.mktemp("environment"), distributions())


@pytest.fixture(scope="module")
def environment_of_jazzy(wheel, tmp_path_factory) -> Path:
    """The same with the NumPy of ROS 2 Jazzy (Ubuntu 24.04), which comes from the package index."""
    folder = tmp_path_factory.mktemp("jazzy")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    (site,) = folder.glob("lib/python*/site-packages")
    link(distributions() - {"numpy"}, site)
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin/python"), "install", "--quiet"]
    fetched = subprocess.run([*pip, "--only-binary", ":all:", "numpy==1.26.*"], capture_output=True, check=False)
    if fetched.returncode:
        pytest.skip("no package index gives numpy 1.26 here")
    # With its dependencies: a requirement that they do not meet is refused.
    run([*pip, "--no-index", str(wheel)], folder)
    return folder


def link(names: set[str], site: Path) -> None:
    """Put installed distributions into another environment."""
    for name in names:
        for file in metadata.distribution(name).files or []:
            if ".." not in file.parts:
                (site / file).parent.mkdir(parents=True, exist_ok=True)
                if name in COPIED:
                    shutil.copy(file.locate(), site / file)
                else:
                    (site / file).symlink_to(file.locate())


@pytest.fixture(scope="module")
def project(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    for name in OWN:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text('OWNER = "the robot"\n')
    return folder


def python(environment: Path, project: Path, *words: str) -> str:
    return run([str(environment / "bin/python"), *words], project).stdout


def test_the_sdk_imports_within_half_a_second_and_leaves_the_projects_own_packages_alone(environment, project):
    runs = [json.loads(python(environment, project, "-c", LOADED)) for _ in range(3)]
    # Of the processor, not of the clock: other tests run beside this one.
    assert in_time(min(measured["took_s"] for measured in runs), IMPORT_CPU_S)
    found = runs[0]
    assert Path(found["core"]).parent == project / "core" and Path(found["service"]).parent == project / "service"
    assert Path(found["revisit"]).is_relative_to(environment)
    assert {"numpy", "zstandard"} <= set(found["modules"])
    heavy = {"torch", "open3d", "faiss", "matplotlib", "scipy", "numba", "cv2", "sqlalchemy", "fastapi"}
    assert heavy.isdisjoint(found["modules"])


def test_the_sdk_alone_posts_a_cloud_and_streams_a_scan(environment, project):
    with live_service() as service:
        shown = python(environment, project, "-c", POSTED, service.http, service.grpc)
    assert shown.splitlines() == ["['maps/yard/sessions/drive/submaps/gate']", "[]"]


@pytest.mark.slow
def test_the_sdk_posts_and_streams_with_the_numpy_of_ros_2_jazzy(environment_of_jazzy, project):
    assert python(environment_of_jazzy, project, "-c", "import numpy; print(numpy.__version__)").startswith("1.26.")
    with live_service() as service:
        shown = python(environment_of_jazzy, project, "-c", POSTED, service.http, service.grpc)
        asked = python(environment_of_jazzy, project, "-c", ASKED, service.http)
    assert shown.splitlines() == ["['maps/yard/sessions/drive/submaps/gate']", "[]"]
    assert asked.splitlines() == ["['maps/yard/sessions/again/submaps/gate']", "(4, 4) float64", "True"]


def test_the_command_says_in_one_line_what_to_install(environment, project, tmp_path):
    def told(*words: str) -> str:
        # On a busy machine lines before it say that something is under way.
        *_, line = run([str(environment / "bin/revisit"), *words], project, status=1).stderr.splitlines()
        return line

    assert told("--help") == "revisit: typer is not installed; this needs: pip install 'revisit-loops[cli]'"
    (site,) = environment.glob("lib/python*/site-packages")
    link(distributions("cli") - distributions(), site)
    assert "Usage" in python(environment, project, "-m", "revisit.cli", "--help")
    assert told("serve").endswith(" is not installed; this needs: pip install 'revisit-loops[service]'")
    write_kitti(tmp_path / "drive", ((cloud_points(n), pose(float(n)), n * 10**8) for n in range(3)))
    for command in ("ingest", "evaluate", "inspect"):
        assert told(command, str(tmp_path / "drive")).endswith("pip install 'revisit-loops[service]'")
    for command in ("demo", "bench"):
        assert told(command).endswith("pip install 'revisit-loops[evaluation]'")
    assert told("loops", "--http", "http://127.0.0.1:1").startswith("revisit: UNREACHABLE")


def test_wheel_and_sdist_hold_every_committed_file_of_the_package_and_nothing_else(source, wheel, unpacked, tmp_path):
    linked = sorted(path.name for path in (source / "revisit").iterdir() if path.is_symlink())
    kept = {path.relative_to(source).as_posix() for path in files(source / "revisit")}
    kept |= {f"revisit/{path.relative_to(source)}" for name in linked for path in files(source / name)}
    assert linked == sorted(OWN) and {"revisit/py.typed", "revisit/core/pipeline.py"} <= kept
    assert names(wheel) == kept

    assert names(built("wheel", unpacked, tmp_path)) == kept


@pytest.mark.slow
@pytest.mark.timeout(900)  # all kernels are compiled, in an environment that has none
def test_the_service_of_a_wheel_made_of_the_sdist_finds_a_loop(unpacked, project, tmp_path):
    wheel = built("wheel", unpacked, tmp_path / "wheels")
    environment = installed(wheel, tmp_path / "environment", distributions("service") | distributions("cli"))
    version = PROJECT["version"]
    assert wheel.name.startswith(f"revisit_loops-{version}-")
    assert python(environment, project, "-m", "revisit.cli", "--version") == f"revisit {version}\n"
    (tmp_path / "home").mkdir()
    with closing(InstalledService(environment, project, tmp_path / "home")) as service:
        example = [environment / "bin/python", ROOT / "docs/examples/rest_client.py"]
        variables = {**clean(), "REVISIT_HTTP": service.url}
        shown = subprocess.run(example, cwd=project, env=variables, capture_output=True, text=True, check=True).stdout
        assert shown.count(" is where ") == 1 and "score 1.00" in shown
        assert service.terminate()[0] == 0


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts]


def names(wheel: Path) -> set[str]:
    """The files of the package in a wheel."""
    with zipfile.ZipFile(wheel) as opened:
        return {name for name in opened.namelist() if not name.partition("/")[0].endswith(".dist-info")}

"""The service as systemd runs it: an installation that it may not write to, a user without a home directory."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from llvmlite import binding
from numba.core.caching import UserProvidedCacheLocator

from revisit.service import compiled_kernels
from revisit.service.__main__ import main
from revisit.service.compiled_kernels import choose_cache
from tests.support.processes import ServiceProcess

ROOT = Path(__file__).resolve().parents[2]
KERNELS = ROOT / "core" / "kernels"
READ_ONLY = 'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"'
NAMESPACE = ("unshare", "--mount", "--map-root-user", "sh", "-c", READ_ONLY, str(KERNELS))


def in_read_only_install(*command: str, home: Path) -> subprocess.CompletedProcess[str]:
    """Run where the kernels' folder cannot be written to, and there is no home directory."""
    kept = {name: value for name, value in os.environ.items() if name not in ("HOME", "NUMBA_CACHE_DIR")}
    environment = {**kept, "HOME": "/proc/none", "REVISIT_HOME": str(home), "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [*NAMESPACE, *command], env=environment, capture_output=True, text=True, check=False, timeout=240
    )


def may_mount() -> bool:
    try:
        return in_read_only_install("true", home=Path("/")).returncode == 0
    except OSError:
        return False


needs_mount = pytest.mark.skipif(not may_mount(), reason="no user namespaces here: nothing can be mounted read-only")

COMPILES = "from revisit.core.kernels import choose_returns"
CHOOSES = "import os, pathlib; from revisit.service.compiled_kernels import choose_cache as c"
CHOSEN = "print(c(pathlib.Path(os.environ['REVISIT_HOME'])))"


@needs_mount
def test_kernels_compile_in_an_installation_that_is_read_only_and_without_a_home_directory(tmp_path):
    alone = in_read_only_install(sys.executable, "-c", COMPILES, home=tmp_path)
    assert alone.returncode != 0 and "no locator available" in alone.stderr
    chosen = in_read_only_install(sys.executable, "-c", f"{CHOOSES}; {CHOSEN}; {COMPILES}", home=tmp_path)
    assert chosen.returncode == 0, chosen.stderr
    assert chosen.stdout.strip() == str(tmp_path / "compiled-kernels")


class ReadOnlyService(ServiceProcess):
    """A gateway with an installation that it may not write to, and without a home directory."""

    launcher = ("env", "-u", "NUMBA_CACHE_DIR", "HOME=/proc/none", *NAMESPACE)


@needs_mount
def test_a_gateway_starts_in_an_installation_that_is_read_only_and_without_a_home_directory(tmp_path):
    with closing(ReadOnlyService(tmp_path, workers=0)) as service:
        assert (tmp_path / "compiled-kernels").is_dir()
        assert service.terminate()[0] == 0


def test_a_worker_chooses_a_folder_in_its_home_where_the_code_is_read_only(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("REVISIT_HOME", str(tmp_path))
    main(["migrate"])
    monkeypatch.setattr(compiled_kernels, "_writable", lambda code: code != KERNELS)
    main(["seen", "--id", "w"])
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "compiled-kernels")
    assert (tmp_path / "compiled-kernels").stat().st_mode & 0o077 == 0
    # Who chose a folder keeps it.
    assert choose_cache(tmp_path / "another") is None


def test_a_folder_that_can_be_written_to_is_used_as_it_is(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(compiled_kernels, "_writable", lambda _: True)
    assert choose_cache(tmp_path) is None and not list(tmp_path.iterdir())


def test_kernels_that_were_shipped_are_copied_once_to_where_numba_looks_for_them(tmp_path, monkeypatch):
    code, home = tmp_path / "kernels", tmp_path / "home"
    (code / "__pycache__").mkdir(parents=True)
    (code / "__pycache__" / "arcs.seen-1.py311.nbi").write_bytes(b"index")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setattr(compiled_kernels, "_writable", lambda _: False)
    monkeypatch.setattr(compiled_kernels, "_CODE", (code,))
    folder = choose_cache(home)
    copied = home / "compiled-kernels" / UserProvidedCacheLocator.get_suitable_cache_subpath(str(code / "arcs.py"))
    assert folder == home / "compiled-kernels"
    assert (copied / "arcs.seen-1.py311.nbi").read_bytes() == b"index"
    (copied / "arcs.seen-1.py311.nbi").write_bytes(b"compiled for another processor")
    assert choose_cache(home) is None
    assert (copied / "arcs.seen-1.py311.nbi").read_bytes() == b"compiled for another processor"
    (code / "__pycache__" / "arcs.seen-1.py311.nbi").write_bytes(b"of a later version")
    choose_cache(home)
    assert (copied / "arcs.seen-1.py311.nbi").read_bytes() == b"of a later version"


ASKED = "from revisit.core.kernels.processor import choose_processor as choose; print(choose())"


@pytest.mark.parametrize(("name", "expected"), [("host", "get_host_cpu_name"), ("znver3", "znver3"), ("", "x86-64-v3")])
def test_kernels_are_compiled_for_the_common_processor_unless_another_is_named(name, expected):
    host = binding.get_host_cpu_name()
    if not name and not binding.get_host_cpu_features().get("avx2"):
        pytest.skip("this processor is older than x86-64-v3")
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA")}
    environment |= {"NUMBA_CPU_NAME": name} if name else {}
    told = subprocess.run([sys.executable, "-c", ASKED], env=environment, capture_output=True, text=True, check=True)
    assert told.stdout.strip() == expected.replace("get_host_cpu_name", host)

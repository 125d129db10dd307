"""A file of hashes: made of wheels, taken by pip, and of no use for a wheel that somebody changed."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from packaging.version import Version

from scripts.lock import DoesNotFit, locked, pins, sha256

METADATA = "Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n"
WHEEL = "Wheel-Version: 1.0\nGenerator: a test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
PINNED = {"tiny": Version("1.0")}


def tiny_wheel(folder: Path, code: str) -> Path:
    """A wheel of one module."""
    folder.mkdir(exist_ok=True)
    path = folder / "tiny-1.0-py3-none-any.whl"
    files = {"tiny.py": code, "tiny-1.0.dist-info/METADATA": METADATA, "tiny-1.0.dist-info/WHEEL": WHEEL}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {**files, "tiny-1.0.dist-info/RECORD": ""}.items():
            archive.writestr(name, content)
    return path


def install(lock: Path, folder: Path, target: Path) -> subprocess.CompletedProcess[str]:
    options = ["--isolated", "--no-index", "-f", str(folder), "--no-deps", "--no-cache-dir", "--target", str(target)]
    command = [sys.executable, "-m", "pip", "install", *options, "--require-hashes", "-r", str(lock)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_pip_installs_what_was_locked_and_refuses_a_wheel_that_was_changed(tmp_path):
    sound, changed = tiny_wheel(tmp_path / "sound", "A = 1\n"), tiny_wheel(tmp_path / "changed", "A = 2\n")
    lock = tmp_path / "requirements.lock"
    lock.write_text("\n".join(locked([sound], PINNED)))
    assert install(lock, sound.parent, tmp_path / "first").returncode == 0
    assert (tmp_path / "first/tiny.py").read_text() == "A = 1\n"
    refused = install(lock, changed.parent, tmp_path / "second")
    assert refused.returncode != 0 and "DO NOT MATCH THE HASHES" in refused.stderr
    assert not (tmp_path / "second/tiny.py").exists()


def test_wheels_of_several_platforms_make_one_entry(tmp_path):
    one, other = tiny_wheel(tmp_path / "one", "A = 1\n"), tiny_wheel(tmp_path / "other", "A = 2\n")
    first, second = sorted((sha256(one), sha256(other)))
    expected = f"tiny==1.0 \\\n    --hash=sha256:{first} \\\n    --hash=sha256:{second}"
    assert list(locked([one, other], PINNED)) == [expected]


@pytest.mark.parametrize("pinned", [{}, {"tiny": Version("1.1")}])
def test_a_wheel_that_is_not_pinned_is_refused(tmp_path, pinned):
    with pytest.raises(DoesNotFit, match=r"tiny-1.0-py3-none-any.whl is not what"):
        list(locked([tiny_wheel(tmp_path / "wheels", "")], pinned))


def test_a_build_of_its_own_is_named_as_one(tmp_path):
    path = tiny_wheel(tmp_path / "wheels", "").rename(tmp_path / "tiny-1.0+cpu-py3-none-any.whl")
    assert list(locked([path], PINNED)) == [f"tiny==1.0+cpu \\\n    --hash=sha256:{sha256(path)}"]


def test_the_pins_are_those_of_the_constraints():
    assert pins("Tiny_Thing==1.0\n# a comment\nother==2.1.0\n") == {
        "tiny-thing": Version("1.0"),
        "other": Version("2.1.0"),
    }

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import pytest

MEMORY = Path("/dev/shm")


@pytest.fixture
def folder(tmp_path):
    """A folder in memory where there is one: a process that is killed does not take the kernel's files along.

    What a power cut takes is another matter, see power_cut.py.
    """
    if not os.access(MEMORY, os.W_OK):
        yield tmp_path
        return
    made = Path(tempfile.mkdtemp(prefix="revisit-", dir=MEMORY))
    yield made
    shutil.rmtree(made)

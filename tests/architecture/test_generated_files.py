"""Generated files that are committed are what their generators write."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def load(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_stubs_are_what_the_proto_files_give(tmp_path):
    load(ROOT / "proto" / "generate.py").generate(tmp_path)
    fresh = {path.name: path.read_text() for path in (tmp_path / "revisit" / "v1").iterdir()}
    committed = {path.name: path.read_text() for path in (ROOT / "revisit" / "v1").glob("*_pb2*.py*")}
    assert fresh == committed


def test_the_proto_files_are_lint_clean():
    buf = Path(sys.executable).parent / "buf"
    result = subprocess.run([buf, "lint", "proto"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (0, "")


def test_the_openapi_document_is_what_the_app_serves():
    from service.rest.openapi import document

    committed = json.loads((ROOT / "docs" / "reference" / "openapi.json").read_text())
    assert committed == document()

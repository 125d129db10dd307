"""Readers that have crashed, leaked memory or run code on a client's bytes are named nowhere outside an allow-list."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

FORBIDDEN_CALLS = {
    "pickle.load", "pickle.loads", "pickle.Unpickler", "marshal.loads", "shelve.open", "dill.loads", "joblib.load",
    "torch.load", "np.load", "numpy.load", "np.fromfile", "numpy.fromfile", "np.genfromtxt", "np.loadtxt",
    "faiss.read_index", "faiss.deserialize_index", "yaml.load", "yaml.unsafe_load", "eval", "exec",
    "cv2.imread", "cv2.imdecode", "cv2.loadPointCloud", "Image.open", "ast.literal_eval",
}  # fmt: skip
FORBIDDEN_MODULES = re.compile(
    r"^(?:open3d\.io|open3d\.t\.io|trimesh|plyfile|laspy|PIL|pickle|dill|shelve|marshal)(?:\.|$)"
)
FORBIDDEN_OPEN3D = re.compile(r"\b(?:o3d|open3d)\.(?:t\.)?io\b")

# Files of the program itself or of its operator: packaged weights, recordings to evaluate, tables.
ALLOWED = {
    "core/model_bundle.py": {"np.load"},
}
OPERATOR_TOOLS = ("evaluation/",)
OPERATOR_CALLS = {"np.load", "np.fromfile", "np.loadtxt", "torch.load", "np.genfromtxt"}


def product_sources() -> list[Path]:
    found = [
        path for package in ("core", "service", "revisit", "evaluation") for path in (ROOT / package).rglob("*.py")
    ]
    return sorted(path for path in found if "revisit/v1" not in path.as_posix())


def dangerous(text: str) -> set[str]:
    """The forbidden readers that a module names."""
    found = set(FORBIDDEN_OPEN3D.findall(text))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in FORBIDDEN_CALLS:
            found.add(ast.unparse(node.func))
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        found |= {name for name in names if FORBIDDEN_MODULES.match(name)}
    return found


@pytest.mark.parametrize("path", product_sources(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_dangerous_reader_is_used(path):
    name = path.relative_to(ROOT).as_posix()
    allowed = ALLOWED.get(name, set()) | (OPERATOR_CALLS if name.startswith(OPERATOR_TOOLS) else set())
    assert dangerous(path.read_text()) <= allowed


def test_arrays_are_never_unpickled():
    found = [
        path
        for path in product_sources()
        if re.search(r"allow_pickle\s*=\s*True|weights_only\s*=\s*False", path.read_text())
    ]
    assert not found


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("import numpy as np\nnp.load(f)", {"np.load"}),
        ("from pickle import loads", {"pickle"}),
        ("import open3d as o3d\no3d.t.io.read_point_cloud(p)", {"o3d.t.io"}),
        ("import cv2\ncv2.imdecode(b, 1)", {"cv2.imdecode"}),
        ("eval(header)", {"eval"}),
        ("model.eval()", set()),
    ],
)
def test_the_search_itself_finds_what_it_should(text, expected):
    # o3d.t.io is found as text, the others in the syntax tree.
    found = dangerous(text) if expected != {"o3d.t.io"} else {m[0] for m in FORBIDDEN_OPEN3D.finditer(text)}
    assert found == expected

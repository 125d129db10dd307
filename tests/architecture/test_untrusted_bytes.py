"""Readers that have crashed, leaked memory or run code on a client's bytes are named nowhere outside an allow-list."""

from __future__ import annotations

import ast
import re

import pytest

from tests.support.sources import calls, modules

PRODUCT = modules("core", "service", "revisit", "evaluation")
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
    "core/codec/learned_chances.py": {"np.load"},  # of the package itself
}
OPERATOR_TOOLS = ("evaluation/",)
OPERATOR_CALLS = {"np.load", "np.fromfile", "np.loadtxt", "torch.load", "np.genfromtxt"}

WORDS = re.compile(
    r"\b(?:open3d|o3d|trimesh|plyfile|laspy|PIL|"
    + "|".join(sorted({word for name in FORBIDDEN_CALLS for word in name.split(".")} - {"np", "numpy", "cv2", "open"}))
    + r")\b"
)
"""A text without any of these has no reader to look for in its syntax tree."""


def dangerous(text: str, tree: ast.Module) -> set[str]:
    """The forbidden readers that a module names: Open3D's as text, others in the syntax tree."""
    found = {match[0] for match in FORBIDDEN_OPEN3D.finditer(text)}
    found |= {ast.unparse(call.func) for call in calls(tree)} & FORBIDDEN_CALLS
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    names = [alias.name for node in imports if isinstance(node, ast.Import) for alias in node.names]
    names += [node.module for node in imports if isinstance(node, ast.ImportFrom) and node.module]
    return found | {name for name in names if FORBIDDEN_MODULES.match(name)}


def allowed(name: str) -> set[str]:
    return ALLOWED.get(name, set()) | (OPERATOR_CALLS if name.startswith(OPERATOR_TOOLS) else set())


def test_no_dangerous_reader_is_used():
    suspects = [module for module in PRODUCT if WORDS.search(module.text)]
    found = {module.name: dangerous(module.text, module.tree) - allowed(module.name) for module in suspects}
    assert {name: readers for name, readers in found.items() if readers} == {}


def test_arrays_are_never_unpickled():
    unpickles = re.compile(r"allow_pickle\s*=\s*True|weights_only\s*=\s*False")
    assert [module.name for module in PRODUCT if unpickles.search(module.text)] == []


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
    assert WORDS.search(text)
    assert dangerous(text, ast.parse(text)) == expected

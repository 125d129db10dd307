"""Files are made by service/engines/local/files/disk.py and nowhere else in the service."""

from __future__ import annotations

import ast

import pytest

from tests.support.sources import calls, modules

HOME = "service/engines/local/files/disk.py"
MAKERS = {
    "write_bytes", "write_text", "touch", "mknod", "mkstemp", "NamedTemporaryFile", "TemporaryFile", "copyfile",
    "copytree", "copy2",
}  # fmt: skip


def makes_files(tree: ast.Module) -> set[str]:
    """The calls of a module that can make or overwrite a file."""
    return {ast.unparse(call.func) for call in calls(tree) if _makes(ast.unparse(call.func), call)}


def _makes(called: str, call: ast.Call) -> bool:
    name = called.rpartition(".")[2]
    if name in MAKERS or called in ("os.open", "shutil.copy"):
        return True
    return name == "open" and _writes(call.args[1:2] if called == "open" else call.args[:1], call.keywords)


def _writes(modes: list[ast.expr], keywords: list[ast.keyword]) -> bool:
    """Whether a mode of `open` is one that writes."""
    modes = modes + [keyword.value for keyword in keywords if keyword.arg == "mode"]
    return any(isinstance(mode, ast.Constant) and set("wax+") & set(str(mode.value)) for mode in modes)


ALLOWED = {
    # Tells the kernel something; no file.
    "service/worker/confinement.py": {"Path('/proc/self/oom_score_adj').write_text"},
    # Opens a folder to lock it: `open` takes files alone.
    "service/adapters/warmup.py": {"os.open"},
    # A cache of compiled code: whatever is lost is compiled again.
    "service/compiled_kernels.py": {"beside.write_bytes"},
}


def test_only_the_disk_module_makes_files():
    others = [module for module in modules("service") if module.name != HOME]
    found = {module.name: makes_files(module.tree) - ALLOWED.get(module.name, set()) for module in others}
    assert {name: makers for name, makers in found.items() if makers} == {}
    assert makes_files(next(module.tree for module in modules("service") if module.name == HOME))


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Path('x').write_bytes(b'')", True),
        ("open('x', 'wb')", True),
        ("path.open('a')", True),
        ("os.open('x', os.O_CREAT)", True),
        ("shutil.copyfile(a, b)", True),
        ("open('x')", False),
        ("path.open('rb')", False),
        ("path.open(mode='w')", True),
        ("table.copy()", False),
        ("scans.open(tenant, session)", False),
        ("names.append('x')", False),
    ],
)
def test_the_search_itself_finds_what_it_should(text, found):
    assert bool(makes_files(ast.parse(text))) == found

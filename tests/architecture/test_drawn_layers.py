"""What the page on the architecture draws is how the code imports: type-checking imports count, too."""

from __future__ import annotations

import re
import tomllib

import pytest

from tests.support.sources import ROOT, Module, modules

PAGE = (ROOT / "docs/explanation/architecture.md").read_text()
PICTURE = (ROOT / "docs/explanation/packages.svg").read_text()
LINKED = ("core", "service", "evaluation")
"""Folders of the root that are packages of `revisit`."""

Arrow = tuple[str, str]


def part(dotted: str) -> str:
    """The package of `revisit` that a module is in, "" for `revisit` itself."""
    return (*dotted.split("."), "")[1]


def imported(module: Module) -> list[str]:
    """The modules of `revisit` that a module imports, anywhere in it."""
    return re.findall(r"^ *(?:from|import) (revisit\.[\w.]+)", module.text, re.MULTILINE)


def arrows_of_packages() -> set[Arrow]:
    """Which package imports which."""
    found = set()
    for module in modules(*LINKED, "revisit"):
        own = part("revisit." + module.name.removeprefix("revisit/").removesuffix(".py").replace("/", "."))
        found |= {(own, part(name)) for name in imported(module)}
    return {(own, other) for own, other in found if own != other and own not in ("", "__init__") and other}


def drawn_arrows() -> set[Arrow]:
    """The arrows of the diagram, one for each pair of names."""
    (diagram,) = re.findall(r"flowchart TD\n(.*?)```", PAGE, re.DOTALL)
    sides = [line.split(" --> ") for line in re.sub(r"\[revisit/\w+\]", "", diagram).splitlines() if " --> " in line]
    return {
        (one.strip(), other.strip()) for left, right in sides for one in left.split("&") for other in right.split("&")
    }


def closed(arrows: set[Arrow]) -> set[Arrow]:
    """The arrows and all ways along them."""
    while True:
        more = arrows | {(a, d) for a, b in arrows for c, d in arrows if b == c}
        if more == arrows:
            return arrows
        arrows = more


def rooms_by_line() -> dict[str, int]:
    """The line of the table of features in which each of them stands."""
    (table,) = re.findall(r"\| features \| \|\n\|---\|---\|\n(.*?)\n\n", PAGE, re.DOTALL)
    return {
        name: number
        for number, line in enumerate(table.splitlines())
        for name in re.findall(r"`(\w+)`", line.split("|")[1])
    }


@pytest.fixture(scope="module")
def imports() -> set[Arrow]:
    return arrows_of_packages()


def test_every_import_goes_along_the_drawn_arrows_and_every_arrow_is_an_import(imports):
    drawn = drawn_arrows()
    assert {(own, other) for own, other in imports if other != "internal"} - closed(drawn) == set()
    assert drawn - imports == set()


def test_the_drawn_arrows_make_no_circle():
    assert [one for one, other in closed(drawn_arrows()) if one == other] == []
    assert ("a", "a") in closed({("a", "b"), ("b", "a")})


def test_the_picture_names_every_package_of_the_diagram():
    names = {name for arrow in drawn_arrows() for name in arrow}
    assert {name for name in names if f">revisit/{name}<" not in PICTURE} == set()


def test_every_room_stands_in_the_table_of_features_below_those_that_it_imports():
    line, rooms = rooms_by_line(), {path.name for path in (ROOT / "service/features").iterdir() if path.is_dir()}
    assert line.keys() == rooms - {"__pycache__"}
    arrows = {
        (module.name.split("/")[2], name.split(".")[3])
        for module in modules("service/features")
        for name in imported(module)
        if name.startswith("revisit.service.features.")
    }
    assert [(one, other) for one, other in arrows if one != other and line[one] <= line[other]] == []


def test_the_contracts_find_circles_everywhere_with_type_checking_imports():
    linter = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    assert not linter.get("exclude_type_checking_imports", False)
    (circles,) = (one for one in linter["contracts"] if one["type"] == "acyclic_siblings")
    assert circles["ancestors"] == linter["root_packages"] and "ignore_imports" not in circles

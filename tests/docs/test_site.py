"""The site of the documents: what `make docs` builds, checked without building it."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import tomllib
from pathlib import Path

import pytest

from docs._extensions.generated_parts import PARTS
from docs._extensions.reference_pages import command_pages, package_pages
from sgp.app import build
from tests.public_names import ROOMS, public_values

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(
    path.relative_to(DOCS).with_suffix("").as_posix()
    for path in DOCS.rglob("*.md")
    if not path.relative_to(DOCS).parts[0].startswith(("_", "generated"))
)
EXAMPLES = sorted((DOCS / "gallery").glob("*.py"))
GUIDE = (DOCS / "python.md").read_text(encoding="utf-8").partition("## Namespaces")[0]
_TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def test_every_page_is_in_a_table_of_contents() -> None:
    listed = {"index"}
    for page in PAGES:
        for entries in _TOCTREE.findall((DOCS / f"{page}.md").read_text(encoding="utf-8")):
            for entry in filter(None, entries.splitlines()):
                if not entry.startswith(":"):
                    folder = (DOCS / page).parent
                    found = [*folder.glob(f"{entry}.md")]
                    assert found or entry.startswith("generated/"), f"{page}: {entry}"
                    listed |= {one.relative_to(DOCS).with_suffix("").as_posix() for one in found}
    assert listed == {*PAGES}


def test_every_measured_table_is_linked() -> None:
    text = (DOCS / "project.md").read_text(encoding="utf-8")
    tables = {path.name for path in (DOCS / "measured").glob("*.csv")}
    assert {*re.findall(r"\(measured/(.+?\.csv)\)", text)} == tables


def test_each_door_has_three_to_five_links() -> None:
    doors = (DOCS / "index.md").read_text(encoding="utf-8").split("{container} door\n")[1:]
    links = [re.findall(r"^- \[[^]]+\]\(([^)#]+)", door, re.MULTILINE) for door in doors]
    assert [re.match(r"\*\*(\w+)\*\*", door)[1] for door in doors] == [
        "Museum",
        "Lab",
        "Inspection",
        "Research",
    ]
    for link in (link for door in links for link in door):
        assert (DOCS / link).exists() or link.startswith("generated/"), link
    assert all(3 <= len(one) <= 5 for one in links)


def test_generated_parts_have_their_place() -> None:
    found = {
        page: re.findall(r"<!-- generated: (.*) -->", (DOCS / f"{page}.md").read_text("utf-8"))
        for page in PAGES
    }
    assert {page: names for page, names in found.items() if names} == {
        page: [*parts] for page, parts in PARTS.items()
    }


def test_the_packages_of_the_site_are_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pinned = (ROOT / "constraints.txt").read_text(encoding="utf-8").lower()
    for requirement in project["optional-dependencies"]["docs"]:
        assert f"\n{requirement.partition('>')[0]}==" in pinned, requirement


def test_every_command_has_a_section_with_its_options() -> None:
    pages, app = dict(command_pages()), build()
    for name in app:
        if name.startswith("-"):
            continue
        commands = [one for one in app[name] if not one.startswith("-")]
        if commands:
            page = pages["capture" if name == "capture" else f"sgp-{name}"]
            for command in commands:
                assert f"{name} {command}``\n---" in page
        else:
            assert f"``sgp {name}``\n---" in pages["sgp"]
    assert "\n``--spheres``\n   Estimate the lights from chrome spheres" in pages["sgp"]
    assert "--json" in pages["index"]
    assert "``--json``" not in pages["sgp"]


def test_every_public_name_has_a_place() -> None:
    pages = dict(package_pages())
    for name, value in public_values():
        room, last = name.split(".")[0], name.rpartition(".")[2]
        places = [page for page in pages if page.startswith(room)]
        found = [
            page
            for page in places
            if re.search(rf"^\.\. \S+:: ({re.escape(page)}\.)?{last}$", pages[page], re.MULTILINE)
        ]
        assert found, name
        assert inspect.getdoc(value) or "py:data" in pages[found[0]]


def verbs() -> set[str]:
    """Return the functions that the guide imports or names."""
    names = {*re.findall(r"\b[a-z_]+\b", GUIDE)}
    return {
        name
        for room in ROOMS
        for name in names & {*importlib.import_module(room).__all__}
        if inspect.isfunction(getattr(importlib.import_module(room), name))
    }


def test_every_verb_of_the_guide_has_an_example() -> None:
    assert len(verbs()) >= 20
    assert verbs() <= {path.stem for path in EXAMPLES}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short_and_shows_its_verb(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    title, line, _, *about = ast.get_docstring(tree).splitlines()
    assert line == "=" * len(title)
    assert len(re.findall(r"[.](?= [A-Z]|$)", " ".join(about))) == 2
    assert re.match(rf"`[\w.]+\.{path.stem}` ", about[0])
    assert 15 <= len(text.partition('"""\n\n')[2].splitlines()) <= 40
    assert "plt.show()" in text
    called = {
        node.func.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert path.stem in called
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in ROOMS:
            public = importlib.import_module(node.module).__all__
            assert {one.name for one in node.names} <= {*public}

"""Link the page's ES modules into one script, without a bundler (decision 60)."""

from __future__ import annotations

import posixpath
import re
from functools import cache
from importlib.resources import files
from typing import Final

# The tabs of the page after the one with the light: modules of the folder `views`, in this order.
VIEWS: Final[tuple[str, ...]] = ("surface3d",)

_IMPORT: Final = re.compile(r'^import \{([^}]*)\} from "(\.{1,2}/[\w/.-]+)";\n', re.MULTILINE)
_EXPORT: Final = re.compile(
    r"^export (?=(?:async )?(?:function\*?|const|let|class)\s+(\w+))", re.MULTILINE
)
_NEEDS: Final = re.compile(r"^// Needs: ([\w-]+)$", re.MULTILINE)


class LinkError(Exception):
    """Error for modules that do not fit together: an error in this program."""


@cache
def asset(path: str) -> str:
    """Return a text file of this folder."""
    return files("sgp.report").joinpath(path).read_text(encoding="utf-8")


@cache
def linked(views: tuple[str, ...] = VIEWS) -> str:
    """Return the script of the page: ``js/main.js``, the views, and all modules they import."""
    modules: dict[str, str] = {}
    for view in views:
        _add(f"views/{view}.js", modules, ())
    _add("js/main.js", modules, ())
    listed = ", ".join(f"{{id: {view!r}, ...{_variable(f'views/{view}.js')}}}" for view in views)
    start = f"{_variable('js/main.js')}.start([{listed}]);\n"
    return '"use strict";\n' + "".join(modules.values()) + start


@cache
def libraries(views: tuple[str, ...] = VIEWS) -> tuple[str, ...]:
    """Return the libraries that views name in a line ``// Needs: NAME``, with their licences."""
    names = dict.fromkeys(
        name for view in views for name in _NEEDS.findall(asset(f"views/{view}.js"))
    )
    return tuple(
        f"/*!\n{_comment(asset(f'vendor/{name}.LICENSE'))}\n*/\n{asset(f'vendor/{name}.js')}"
        for name in names
    )


def _add(path: str, modules: dict[str, str], importing: tuple[str, ...]) -> None:
    """Add a module after those that it imports, as a constant with its exports."""
    if path in modules:
        return
    if path in importing:
        raise LinkError(f"{' -> '.join([*importing, path])}: modules import each other")
    source = asset(path)
    lines = []
    for names, target in _IMPORT.findall(source):
        found = posixpath.normpath(posixpath.join(posixpath.dirname(path), target))
        _add(found, modules, (*importing, path))
        missing = {name.strip() for name in names.split(",")} - set(exports(found))
        if missing:
            raise LinkError(f"{path}: {found} does not export {', '.join(sorted(missing))}")
        lines.append(f"const {{{names}}} = {_variable(found)};\n")
    body = _EXPORT.sub("", _IMPORT.sub("", source))
    if re.search(r"^(import|export)\b", body, re.MULTILINE):
        raise LinkError(f"{path}: an import or export has a form that is not linked")
    returned = ", ".join(exports(path))
    content = f"{''.join(lines)}{body}return {{{returned}}};\n"
    modules[path] = f"const {_variable(path)} = (() => {{\n{content}}})();\n"


def exports(path: str) -> list[str]:
    """Return the names that a module exports."""
    return _EXPORT.findall(asset(path))


def _variable(path: str) -> str:
    return "$" + re.sub(r"\W", "_", path.removesuffix(".js"))


def _comment(licence: str) -> str:
    return licence.strip().replace("*/", "* /")

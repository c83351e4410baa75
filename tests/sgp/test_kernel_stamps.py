"""A kernel is compiled again after a change in a kernel of another file that it calls.

numba keeps compiled code until the file of the kernel changes, also across an update of an
installed package, and does not look at the files of the functions that are compiled into it. Each
file therefore names the others with the first digits of their SHA-256.
"""

import ast
import re
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")


def compiled_in(text: str) -> Iterator[str]:
    """Yield the files whose names the kernels of a file use, annotations excepted."""
    tree = ast.parse(text)
    used = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and "numba." in ast.unparse(node.decorator_list[:1]):
            parts = [*node.body, *node.decorator_list]
            used |= {n.id for part in parts for n in ast.walk(part) if isinstance(n, ast.Name)}
    for node in tree.body:
        module = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
        names = {name.asname or name.name for name in getattr(node, "names", ())}
        if module.split(".")[0] in PACKAGES and used & names:
            yield from sorted({file_of(module, name) for name in used & names})


def file_of(module: str, name: str) -> str:
    """Return the file from which a name is imported, behind the face of a folder."""
    place = module.replace(".", "/")
    face = ROOT / place / "__init__.pyi"
    if face.exists():
        found = re.search(rf"from \.(\w+) import \w+ as {name}$", face.read_text(), re.M)
        place = f"{place}/{found[1]}" if found else place
    return f"{place}.py"


def test_a_file_names_the_versions_of_the_kernels_that_it_calls() -> None:
    missing = []
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        for file in compiled_in(text) if "numba." in text else ():
            line = f"# Compiled in: {file} {sha256((ROOT / file).read_bytes()).hexdigest()[:12]}"
            if line not in text.splitlines():
                missing.append(f"{path}: {line}")
    assert not missing, "write these lines into the files"


def test_callers_are_found() -> None:
    solver = (ROOT / "processing/stereo/best.py").read_text(encoding="utf-8")
    assert list(compiled_in(solver)) == [
        f"processing/stereo/{name}.py" for name in ("cauchy", "pixel_algebra", "reflectance_fit")
    ]
    text = (
        "from simulator.a import Kind, helper\nfrom processing.b import FAST\n"
        "from acquisition.c import other\n@numba.njit(fastmath=FAST)\n"
        "def kernel(x: Kind) -> Kind:\n    return helper(x)\n\ndef plain():\n    return other()\n"
    )
    assert list(compiled_in(text)) == ["simulator/a.py", "processing/b.py"]

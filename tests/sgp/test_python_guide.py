"""docs/python.md: its commands and its examples work, in this order."""

import re
import shlex
from pathlib import Path

import pytest

GUIDE = (Path(__file__).parents[2] / "docs/python.md").read_text(encoding="utf-8")
COMMANDS = [shlex.split(line) for line in re.findall(r"^    ((?:sgp|capture) .*)$", GUIDE, re.M)]
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", GUIDE, re.M | re.S)


@pytest.mark.slow
def test_the_examples_work(sgp, tmp_path, monkeypatch, capsys) -> None:
    assert (len(COMMANDS), len(EXAMPLES)) == (4, 6)
    monkeypatch.chdir(tmp_path)
    for program, *words in COMMANDS:
        assert sgp(*([program] if program == "capture" else []), *words).code == 0
    printed = []
    for number, example in enumerate(EXAMPLES, 1):
        exec(compile(example, f"example {number}", "exec"), {"__name__": "__main__"})
        printed.append(capsys.readouterr().out)
    normals, spheres, detail, mesh, loop, line = printed
    assert "12 frames of 160 x 128 px" in normals
    assert spheres.count("Sphere(") == 4
    assert float(re.search(r"error of the shape: (\S+) degrees", detail)[1]) < 1
    assert "in mm" in mesh
    assert "Session(recordings/loop, 6 frames, complete)" in loop
    assert len(list(tmp_path.glob("normals/*"))) == 3
    assert (tmp_path / "coin.ply").stat().st_size > 10_000
    assert len(EXAMPLES) == len(re.findall(r"^## \d ", GUIDE, re.M))
    assert line.splitlines()[2] == "part 2: 0.0% of the pixels are tilted by more than 5 degrees"

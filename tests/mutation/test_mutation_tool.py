"""The faults can be planted in the current code, and the tool reports which tests detect them."""

from __future__ import annotations

import ast
import random
from pathlib import Path

import pytest

from tests.mutation.operators import mutants_of
from tests.mutation.planted import PLANTED, Planted
from tests.mutation.survivors import Survivors
from tests.mutation.targets import TARGETS
from tests.mutation.trial import ROOT, Trial
from tests.quick_sample import quick


def text_of(module: str) -> str:
    return (ROOT / module).read_text(encoding="utf-8")


@pytest.mark.parametrize("fault", [pytest.param(fault, id=fault.name) for fault in PLANTED])
def test_a_planted_fault_is_in_the_code_once(fault: Planted) -> None:
    text = text_of(fault.file)
    assert text.count(fault.old) == 1
    changed = text.replace(fault.old, fault.new)
    assert ast.dump(ast.parse(changed)) != ast.dump(ast.parse(text))
    assert fault.file in TARGETS


@pytest.mark.parametrize("module", TARGETS)
def test_core_modules_and_their_tests_exist(module: str) -> None:
    assert (ROOT / module).is_file()
    assert TARGETS[module]
    assert [name for name in TARGETS[module] if not (ROOT / "tests" / name).is_file()] == []


@pytest.mark.parametrize("module", quick(TARGETS, every=5))
def test_faults_are_python_and_change_one_place(module: str) -> None:
    text = text_of(module)
    every = mutants_of(text)
    for mutant in random.Random(0).sample(every, min(5, len(every))):
        compile(mutant.source, module, "exec")
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(text))
        assert text.splitlines()[mutant.line - 1].strip() == mutant.before


@pytest.mark.slow
def test_listed_survivors_can_still_be_planted() -> None:
    for (module, *key), reason in Survivors.read().reasons.items():
        assert len(reason) > 10
        assert tuple(key) in {mutant.key for mutant in mutants_of(text_of(module))}, (module, key)


@pytest.mark.parametrize(
    ("line", "faults"),
    [
        pytest.param("x = a < b <= c", {"a <= b <= c", "a < b < c"}, id="comparisons"),
        pytest.param("x = a is not b", {"a is b"}, id="identity"),
        pytest.param("x = (a) + (  # +\n  b)", {"(a) - (  # +"}, id="brackets and comments"),
        pytest.param("x = a * b**c", {"a / b**c", "a * b*c"}, id="arithmetic"),
        pytest.param("x = a and b or c", {"a or b or c", "a and b and c"}, id="logic"),
        pytest.param("x = -a", {"a"}, id="sign"),
        pytest.param("x = 7", {"8"}, id="whole number"),
        pytest.param("x = 0.25", {"0.5"}, id="number"),
        pytest.param("x = max(a, 1e-12)", {"min(a, 1e-12)"}, id="a guard"),
        pytest.param("x = np.random.default_rng(0)", set(), id="a seed"),
        pytest.param("x = True", {"False"}, id="truth"),
        pytest.param("x = np.min(a)", {"np.max(a)"}, id="extremes"),
        pytest.param("x = abs(a)", {"(a)"}, id="size"),
        pytest.param("x = a if b else c", {"a if not (b) else c"}, id="choice"),
        pytest.param("x = f'{a + 1}'", set(), id="texts are left alone"),
        pytest.param("x: Literal[1] = a", set(), id="so are types"),
        pytest.param("x = 'ä' + a", {"'ä' - a"}, id="columns count bytes"),
    ],
)
def test_faults_of_a_line(line: str, faults: set[str]) -> None:
    found = {mutant.after.partition(" = ")[2] for mutant in mutants_of(line)}
    assert found == faults


def test_faults_of_statements() -> None:
    source = (
        "def f(a):\n    a += g\n    h(a)\n    if a:\n        raise E(1 + 2)\n"
        "    for b in a:\n        break\n    return a\n"
    )
    found = [(m.function, m.line, m.after) for m in mutants_of(source)]
    assert found == [
        ("f", 2, "pass"),
        ("f", 2, "a -= g"),
        ("f", 3, "pass"),
        ("f", 4, "if not (a):"),
        ("f", 5, "pass"),
        ("f", 7, "continue"),
        ("f", 8, "return None"),
    ]


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return Trial(tmp_path_factory.mktemp("trial") / "tree")


ROBUST = "calibration/spheres/geometry/robust.py"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "verdict"),
    [
        pytest.param("4.685", "4.685", "survived", id="no fault"),
        pytest.param("4.685", "4.6", "killed", id="a fault"),
        pytest.param("import numpy as np", "import nothing", "killed", id="no import"),
        pytest.param("    root = ", "    while True: pass\n    root = ", "timeout", id="endless"),
    ],
)
def test_the_verdict_is_the_result_of_the_tests(
    trial: Trial, old: str, new: str, verdict: str
) -> None:
    text = text_of(ROBUST)
    limit_s = 4 if verdict == "timeout" else 60
    outcome = trial.run(ROBUST, text.replace(old, new, 1), TARGETS[ROBUST], limit_s)
    assert outcome.verdict == verdict, outcome.output
    assert text_of(ROBUST) == text


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_kernel_that_others_have_compiled_in_is_faulty_at_once(trial: Trial) -> None:
    kernels, solver = (f"processing/stereo/{name}.py" for name in ("pixel_algebra", "cauchy"))
    assert solver in trial.compiled_from(kernels)
    faulty = text_of(kernels).replace("a12 += wy * z", "a12 -= wy * z")
    exact = "test_lambertian_surface_without_shadows_is_exact"
    tests = (f"processing/test_photometric_stereo.py::{exact}",)
    verdicts = [trial.run(kernels, t, tests, 120).verdict for t in (text_of(kernels), faulty)]
    assert verdicts == ["survived", "killed"]
    assert trial.run(solver, text_of(solver), tests, 120).verdict == "survived"


@pytest.mark.slow
def test_tests_that_do_not_import_the_module_judge_nothing(trial: Trial) -> None:
    with pytest.raises(RuntimeError, match=r"is not what rig/test_protocol_lines\.py import"):
        trial.run(ROBUST, text_of(ROBUST), ("rig/test_protocol_lines.py",), 60)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("fault", [pytest.param(fault, id=fault.name) for fault in PLANTED])
def test_a_planted_fault_is_detected(trial: Trial, fault: Planted) -> None:
    text = text_of(fault.file).replace(fault.old, fault.new)
    outcome = trial.run(fault.file, text, TARGETS[fault.file], 120)
    assert outcome.verdict == "killed", outcome.output


def test_the_working_tree_is_another_folder(tmp_path: Path) -> None:
    copy = Trial(tmp_path / "tree")
    assert copy.original(ROBUST) == text_of(ROBUST)
    assert (tmp_path / "tree" / ROBUST).read_text(encoding="utf-8") == text_of(ROBUST)
    assert not (tmp_path / "tree" / ".git").exists()

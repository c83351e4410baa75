"""The cases of `benchmarks/true_to_the_input.py`: each right, applied and stated, or refused."""

import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
MODULES = sorted(path.stem for path in (BENCHMARKS / "true_to_input").glob("*_cases.py"))


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("module", MODULES)
def test_every_case_has_a_good_outcome(module, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    from true_to_input.case import GOOD
    from true_to_the_input import cases_of, outcome_of

    outcomes = {case.name: outcome_of(case, tmp_path) for case in cases_of(module)}
    assert outcomes
    assert {name: each for name, each in outcomes.items() if each.kind not in GOOD} == {}

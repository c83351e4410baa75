"""Figures of commands: each has a type, a unit and a meaning."""

from __future__ import annotations

import pytest
from typing_extensions import is_typeddict

from docs._extensions.figure_tables import (
    declared,
    described,
    figure_tables,
    record_keys,
    table,
    title,
    verdict_keys,
)
from processing.checks import Cause, Verdict
from sgp.results import COMMANDS, ResultRecord
from sgp.results import metrics as _metrics
from sgp.results import record as _record
from sgp.results import stage_metrics as _stage_metrics

KINDS = [
    kind
    for module in (_metrics, _stage_metrics)
    for kind in vars(module).values()
    if is_typeddict(kind)
]


@pytest.mark.parametrize("kind", KINDS, ids=title)
def test_a_docstring_describes_every_figure_and_no_other(kind: type) -> None:
    texts = described(kind)
    assert texts.keys() == kind.__annotations__.keys()
    assert all(meaning for _, meaning in texts.values())
    assert all(row.count("|") == 5 for row in table(kind))


def test_the_page_has_a_table_for_every_command() -> None:
    page = figure_tables()
    assert set(COMMANDS) <= set(declared())
    for name, rows in declared().items():
        assert rows
        assert "\n".join(rows) in page, name
    for command in COMMANDS:
        assert page.count(f"### `{command}`\n") == 1


def test_every_key_of_a_record_and_of_a_verdict_is_described() -> None:
    tables = (
        (ResultRecord, ResultRecord, record_keys()),
        (_record.CauseTable, Cause, verdict_keys()),
        (_record.TestedTable, Verdict, verdict_keys()),
    )
    for model, documented, page in tables:
        for name in model.model_fields:
            assert described(documented)[name][1], name
            assert f"| `{name}` | " in page


def test_a_figure_names_a_unit_that_its_name_names() -> None:
    """A name such as ``height_range_mm`` and its unit agree."""
    units = {"deg": "deg", "mm": "mm", "px": "px", "us": "µs", "dn": "DN", "percent": "%"}
    for rows in declared().values():
        for row in rows:
            name, _, unit, _ = (cell.strip() for cell in row.strip("|").split("|"))
            last = name.strip("`").removesuffix("_paper").rpartition("_")[2]
            if last in units and "_per_" not in name:
                assert unit == units[last], row

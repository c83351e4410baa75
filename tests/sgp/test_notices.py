"""Every code of a notice has a meaning and a remedy in the one table, which has no other code."""

from __future__ import annotations

from typing import get_args

from acquisition.preflights import check
from acquisition.selftests import finding
from docs._extensions.notice_table import SEVERITIES, TABLE, meanings, notice_table, used_codes
from rig import Notice, Severity
from tests.sgp.test_words import found_in


def test_the_table_has_the_codes_that_are_used() -> None:
    codes = [code for rows in meanings().values() for code in rows]
    assert sorted(codes) == sorted(used_codes())


def test_every_code_has_a_meaning_and_a_remedy() -> None:
    for rows in meanings().values():
        for code, texts in rows.items():
            assert all(text.strip() == text and text.endswith(".") for text in texts), code
            assert not any("|" in text for text in texts), code


def test_the_page_lists_every_code_with_its_severities() -> None:
    assert get_args(Severity) == SEVERITIES
    page = notice_table()
    for code, severities in used_codes().items():
        assert severities <= {*SEVERITIES}
        assert page.count(f"| `{code}` | ") == 1


def test_the_table_has_no_avoided_word() -> None:
    assert not found_in(TABLE.read_text(encoding="utf-8"))


def test_codes_have_the_form_of_one() -> None:
    for code in used_codes():
        assert Notice(code, "text").code == code


def test_findings_and_checks_have_codes() -> None:
    assert set(finding._CODES) == set(get_args(finding.Kind))
    for state in get_args(check.State):
        for name in check._CODES:
            (notice,) = check.Check(name, state, "text").notices
            assert str(notice) == f"{name}: text"

import pickle
from dataclasses import FrozenInstanceError

import pytest

from rig import Notice


def test_text_is_preceded_by_the_place():
    assert str(Notice("lights-unlit", "shows no light", "frames/3.png")) == (
        "frames/3.png: shows no light"
    )
    assert str(Notice("lights-unlit", "no light at all")) == "no light at all"


def test_defaults():
    notice = Notice("mask-estimated", "the mask was estimated")
    assert (notice.where, notice.severity) == ("", "warning")


@pytest.mark.parametrize("code", ["", "Mask", "mask_estimated", "-mask", "mask-", "a--b", "a b\n"])
def test_code_must_be_kebab_case(code):
    with pytest.raises(ValueError, match="kebab case"):
        Notice(code, "text")


@pytest.mark.parametrize("code", ["mask", "mask-estimated", "8-bit", "a-1-b"])
def test_code_in_kebab_case(code):
    assert Notice(code, "text").code == code


def test_severity_must_be_known():
    with pytest.raises(ValueError, match="severity 'fatal'"):
        Notice("mask", "text", severity="fatal")


def test_equal_hashable_and_frozen():
    notice = Notice("mask", "text", "file", "info")
    assert notice == Notice("mask", "text", "file", "info")
    assert len({notice, Notice("mask", "text", "file", "info")}) == 1
    with pytest.raises(FrozenInstanceError):
        notice.text = "other"


def test_pickle_and_repr():
    notice = Notice("mask", "text", "file", "info")
    assert pickle.loads(pickle.dumps(notice)) == notice
    assert repr(notice) == "Notice(code='mask', text='text', where='file', severity='info')"

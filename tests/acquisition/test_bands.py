"""Maps larger than memory: rows in files, and what a kill leaves of them."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    DataError,
    SessionInUseError,
    StorageError,
    read_image,
    write_exr,
    write_mask,
    write_png,
)
from acquisition.files import (
    BandFile,
    BandStore,
    ComputedRows,
    DamagedMapsError,
    MemoryMaps,
    OtherMapsError,
    band_store,
    check_unfinished,
    rows_in_bands,
)
from acquisition.pixels import ImageRows, write_tiff

FORM = {"normals": ((7, 4, 3), np.float32), "used": ((7, 4), np.uint16)}
IDENTITY = {"method": "ls", "inputs": {"a.png": "00"}, "version": "1"}
RNG = np.random.default_rng(3)


def open_store(path: Path, **changes: object) -> BandStore:
    replace = bool(changes.pop("replace", False))
    return BandStore(path / "normals", {**IDENTITY, **changes}, FORM, replace=replace)


def fill(store: BandStore, rows: slice) -> None:
    store["normals"][rows] = np.float32(rows.start + 1)
    store["used"][rows] = rows.start + 1


def test_rows_that_were_completed_survive(tmp_path: Path) -> None:
    with open_store(tmp_path) as store:
        assert store.missing("solve", 7) == [slice(0, 7)]
        for rows in (slice(0, 2), slice(4, 6)):
            fill(store, rows)
            store.complete("solve", rows)
        fill(store, slice(2, 4))  # killed before the journal names it
    journal = store.folder / "journal.jsonl"
    journal.write_bytes(journal.read_bytes() + b'{"step": "so')
    with open_store(tmp_path) as again:
        assert again.missing("solve", 7) == [slice(2, 4), slice(6, 7)]
        np.testing.assert_array_equal(again["used"][0:2], 1)
        np.testing.assert_array_equal(again["normals"][4:6], 5)
        assert np.asarray(again["used"]).shape == (7, 4)
        for rows in again.missing("solve", 7):
            again.complete("solve", rows)
        assert again.missing("solve", 7) == []
        again.remove()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"method": "best"}, "method"),
        ({"version": "2"}, "version"),
        ({"inputs": {"a.png": "01"}}, "inputs"),
        ({"more": 1}, "more"),
    ],
)
def test_maps_of_another_identity_are_refused(
    tmp_path: Path, changes: dict[str, object], named: str
) -> None:
    with open_store(tmp_path) as store:
        store.complete("solve", slice(0, 7))
    with pytest.raises(OtherMapsError, match=f"that differs in {named}: repeat"):
        open_store(tmp_path, **changes)
    with pytest.raises(OtherMapsError, match=named):
        check_unfinished(tmp_path / "normals", {**IDENTITY, **changes})
    check_unfinished(tmp_path / "normals", IDENTITY)
    with open_store(tmp_path) as store:
        assert store.missing("solve", 7) == []
    with open_store(tmp_path, replace=True) as store:
        assert store.missing("solve", 7) == []
    with open_store(tmp_path, **changes, replace=True) as store:
        assert store.missing("solve", 7) == [slice(0, 7)]
        assert not store["used"][0:7].any()


def test_damage_and_strange_files(tmp_path: Path) -> None:
    with open_store(tmp_path) as store:
        store.complete("solve", slice(0, 2))
    journal, identity = store.folder / "journal.jsonl", store.folder / "identity.json"
    good = journal.read_text()
    for line in (
        "[0]",
        "x",
        "{}",
        '{"step": "a", "units": [3, 2], "written": {}}',
        '{"replaced": 1}',
    ):
        journal.write_text(f"{good}{line}\n")
        with pytest.raises(DataError, match="line 2 is damaged"):
            open_store(tmp_path)
    journal.write_text("")
    identity.write_text("no JSON")
    with pytest.raises(DataError, match="unfinished maps"):
        open_store(tmp_path)
    for path in store.folder.iterdir():
        path.unlink()
    store.folder.rmdir()
    target = tmp_path / "elsewhere"
    target.mkdir()
    store.folder.symlink_to(target)
    with open_store(tmp_path) as again:
        assert again.missing("solve", 7) == [slice(0, 7)]
    assert not list(target.iterdir())


def test_a_kill_while_maps_are_removed_leaves_nothing_to_continue(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a file that is missing would be read as zeros."""
    path, form = tmp_path / "normals", {"albedo": ((6, 4), np.float32)}
    store = BandStore(path, {}, form)
    store["albedo"][0:6] = 1.0
    store.complete("solve", slice(0, 6))

    def killed(folder: Path) -> None:
        (folder / "albedo.raw").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(band_store.shutil, "rmtree", killed)
        with pytest.raises(KeyboardInterrupt):
            store.remove()
    store.close()
    assert (store.folder / "journal.jsonl").is_file()
    with BandStore(path, {}, form) as again:
        assert again.missing("solve", 6) == [slice(0, 6)]
    (store.folder / "identity.json").unlink()
    band_store.remove_unfinished(path)
    assert list(tmp_path.iterdir()) == []


def test_maps_in_memory_are_filled_like_those_in_files(tmp_path: Path) -> None:
    with open_store(tmp_path) as store:
        maps = MemoryMaps(FORM)
        given = np.full((7, 4, 3), 3, np.float32)
        for one in (store, maps):
            one["normals"][0:7] = given
            whole = one["normals"][0:7]
            one["normals"][2:3] = 5.0
            one["used"][1:3] = [[2], [3]]
            np.testing.assert_array_equal(whole, 3)  # what was read is not changed
            np.testing.assert_array_equal(given, 3)
            assert sorted(one) == ["normals", "used"]
        for name in FORM:
            np.testing.assert_array_equal(store[name][:], maps[name][:])
            np.testing.assert_array_equal(np.asarray(store[name]), np.asarray(maps[name]))
            assert len(store[name]) == len(maps[name]) == 7
    kept = MemoryMaps(FORM)
    kept["normals"][0:7] = given
    assert np.shares_memory(kept["normals"][:], given)


def test_rows_that_are_replaced_are_not_compared_with_what_they_were(tmp_path: Path) -> None:
    """A kill between the write and its line in the journal leaves either values."""
    with open_store(tmp_path) as store:
        fill(store, slice(0, 7))
        store.complete("solve", slice(0, 7))
        store["used"][3:5] = 9
    with open_store(tmp_path) as store:
        assert store.missing("solve", 7) == []
        assert store.missing("smooth", 7) == [slice(0, 7)]
        store["used"][3:5] = 8
        store.complete("smooth", slice(3, 5))
    with open_store(tmp_path) as store:
        np.testing.assert_array_equal(store["used"][3:5], 8)
    (store.folder / "used.raw").unlink()
    with pytest.raises(DamagedMapsError, match=r"used\.raw: was deleted since a part"):
        open_store(tmp_path)


def test_maps_of_an_earlier_layout_are_not_continued(tmp_path: Path) -> None:
    with open_store(tmp_path) as store:
        identity = store.folder / "identity.json"
        content = json.loads(identity.read_text())
    del content["layout"]
    identity.write_text(json.dumps(content))
    with pytest.raises(OtherMapsError, match="differs in layout"):
        open_store(tmp_path)


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with open_store(tmp_path), pytest.raises(SessionInUseError, match="computing these maps"):
        open_store(tmp_path)


def test_a_full_disk_loses_no_completed_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with open_store(tmp_path) as store:
        fill(store, slice(0, 2))
        store.complete("solve", slice(0, 2))
        with monkeypatch.context() as patched:
            patched.setattr(os, "pwrite", full)
            with pytest.raises(StorageError, match="free space"):
                fill(store, slice(2, 4))
        with monkeypatch.context() as patched:
            patched.setattr(os, "fsync", full)
            with pytest.raises(StorageError, match="free space"):
                store.complete("solve", slice(2, 4))
        assert store.missing("solve", 7) == [slice(2, 7)]
    with monkeypatch.context() as patched:
        patched.setattr(band_store.shutil, "disk_usage", lambda _: type("Usage", (), {"free": 9}))
        with open_store(tmp_path) as store:  # its space is not needed again
            assert store.missing("solve", 7) == [slice(2, 7)]
        with pytest.raises(StorageError, match=r"are free: free space"):
            open_store(tmp_path, replace=True, method="best")


def test_a_band_file_is_an_array_of_rows(tmp_path: Path) -> None:
    values = RNG.normal(size=(9, 5, 3)).astype(np.float32)
    file = BandFile(tmp_path / "a.raw", values.shape, values.dtype)
    file[:4] = values[:4]
    file[4:9] = values[4:].astype(np.float64)
    np.testing.assert_array_equal(file[2:7], values[2:7])
    np.testing.assert_array_equal(np.asarray(file), values)
    file[3:3] = np.zeros((0, 5, 3))
    with pytest.raises(ValueError, match="one after the other"):
        file[::2]
    with pytest.raises(ValueError, match="broadcast"):
        file[0:2] = values[:3]
    os.truncate(file.path, 10)
    with pytest.raises(DataError, match="cut short"):
        file[0:1]
    file.close()
    file.close()


def test_files_of_bands_have_the_bytes_of_whole_maps(tmp_path: Path) -> None:
    """In bands of several sizes: of an array, a file-backed map and computed rows."""
    colour = RNG.normal(size=(130, 3001, 3)).astype(np.float32)  # five bands of the encoder
    colour[:, :50] = 0
    inside = colour[..., 0] > 0
    samples = (colour * 1000).astype(np.int32).astype(np.uint16)

    def both(values: np.ndarray, name: str) -> tuple[BandFile, ComputedRows]:
        file = BandFile(tmp_path / f"{name}.raw", values.shape, values.dtype)
        file[:] = values
        return file, ComputedRows(values.shape, values.dtype, lambda rows: values[rows].copy())

    cases = {
        "a.exr": lambda path, i: write_exr(path, maps[0][i]),
        "b.exr": lambda path, i: write_exr(path, gray[i]),
        "a.png": lambda path, i: write_png(path, maps[1][i], alpha=maps[2][i], description="x"),
        "mask.png": lambda path, i: write_mask(path, maps[2][i]),
    }
    maps = [(v, *both(v, str(i))) for i, v in enumerate((colour, samples, inside))]
    gray = (colour[..., 1], *both(np.ascontiguousarray(colour[..., 1]), "g"))
    for name, write in cases.items():
        path = tmp_path / name
        contents = set()
        for i in range(3):
            write(path, i)
            contents.add(path.read_bytes())
        assert len(contents) == 1, name


def test_rows_of_image_files(tmp_path: Path) -> None:
    gray = RNG.integers(0, 65536, (90, 31)).astype(np.uint16)
    colour = RNG.normal(size=(90, 31, 3)).astype(np.float32)
    write_png(tmp_path / "a.png", gray)
    write_png(tmp_path / "b.png", np.dstack([gray] * 3), alpha=gray > 9)
    write_tiff(tmp_path / "c.tif", gray)
    write_exr(tmp_path / "d.exr", colour)
    for path in sorted(tmp_path.iterdir()):
        whole = read_image(path)
        with ImageRows(path) as rows:
            assert (rows.shape, rows.dtype, len(rows)) == (whole.shape, whole.dtype, len(whole))
            for part in (slice(0, 40), slice(40, 41), slice(41, 90), slice(3, 5), slice(80, None)):
                np.testing.assert_array_equal(rows[part], whole[part], err_msg=path.name)
        rows.close()
    data = (tmp_path / "d.exr").read_bytes()
    (tmp_path / "d.exr").write_bytes(data[: len(data) // 2])
    with ImageRows(tmp_path / "d.exr") as rows, pytest.raises(DataError, match=r"d\.exr: cut"):
        rows[80:90]


def test_bands_cover_all_rows_once() -> None:
    for height, row, band, least in ((10, 4, 13, 1), (10, 4, 3, 1), (10, 0, 1, 1), (9, 4, 1, 4)):
        bands = rows_in_bands(height, row, band, least=least)
        assert [r for rows in bands for r in range(rows.start, rows.stop)] == list(range(height))
        assert all((rows.stop - rows.start) * row <= max(band, least * row) for rows in bands)


def test_the_identity_is_readable(tmp_path: Path) -> None:
    with open_store(tmp_path) as store:
        found = json.loads((store.folder / "identity.json").read_text())
    assert found["method"] == "ls"
    assert found["maps"]["used"] == [[7, 4], "uint16"]

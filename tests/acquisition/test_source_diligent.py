"""DiLiGenT object folders, synthetic and real."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from acquisition import DataError, Lights, read_source, write_png
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data

NAMES = ["003.png", "001.png", "010.png"]
NORMALS = np.zeros((4, 6, 3))
NORMALS[1:3, 1:5] = [0.6, 0, 0.8]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for value, name in enumerate(NAMES):
        write_png(tmp_path / name, np.full((4, 6, 3), value, np.uint16))
    write_png(tmp_path / "mask.png", np.where(NORMALS[..., 2] > 0, 255, 0).astype(np.uint8))
    (tmp_path / "filenames.txt").write_text("".join(f"{name}\r\n" for name in NAMES))
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0.6 0 0.8\n0 0.6 0.8\n")
    (tmp_path / "light_intensities.txt").write_text("1 2 3\n4 5 6\n7 8 9\n")
    savemat(tmp_path / "Normal_gt.mat", {"Normal_gt": NORMALS * 1.001})
    return tmp_path


def test_everything_is_read(folder: Path) -> None:
    source = read_source(folder)
    assert source.kind == "diligent"
    assert source.light_ids == ("003", "001", "010")
    assert [int(frame.read()[0, 0, 0]) for frame in source.frames] == [0, 1, 2]
    assert source.white_level == 65535
    assert source.lights is not None
    assert source.lights.ids == source.light_ids
    np.testing.assert_allclose(source.lights.unit_directions[1], [0.6, 0, 0.8])
    np.testing.assert_array_equal(np.asarray(source.lights.intensities)[2], [7, 8, 9])
    assert source.normals_truth is not None
    assert source.normals_truth.dtype == np.float32
    np.testing.assert_allclose(source.normals_truth, NORMALS, atol=1e-7)
    assert source.mask is not None
    np.testing.assert_array_equal(source.mask, NORMALS[..., 2] > 0)
    assert source.warnings == ()
    texts = {"filenames.txt", "light_directions.txt", "light_intensities.txt"}
    assert {path.name for path in source.files} == {*NAMES, "mask.png", "Normal_gt.mat"} | texts
    assert source.ignored == ()


def test_unused_files_are_listed(folder: Path) -> None:
    write_png(folder / "other.mask.png", np.full((4, 6), 255, np.uint8))
    (folder / "notes.txt").write_text("hello")
    source = read_source(folder, mask_path=folder / "other.mask.png")
    assert source.ignored == ("mask.png", "notes.txt")
    (folder / "light_directions.txt").unlink()
    assert "light_intensities.txt" in read_source(folder).ignored


def test_without_truth_mask_and_lights(folder: Path) -> None:
    for name in ("Normal_gt.mat", "mask.png", "light_directions.txt", "light_intensities.txt"):
        (folder / name).unlink()
    source = read_source(folder)
    assert (source.normals_truth, source.mask, source.lights) == (None, None, None)
    given = Lights(directions=np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1]]))
    assert read_source(folder, lights=given).lights is not None


def test_unknown_normals_are_zero(folder: Path) -> None:
    normals = NORMALS.copy()
    normals[0, 0] = np.nan
    savemat(folder / "Normal_gt.mat", {"Normal_gt": normals})
    truth = read_source(folder).normals_truth
    assert truth is not None
    np.testing.assert_array_equal(truth[0, 0], [0, 0, 0])


def put(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)


DAMAGED_FOLDERS = {
    "image missing": (
        lambda f: (f / "001.png").unlink(),
        r"filenames\.txt: lists 001\.png, which does not exist",
    ),
    "images for more lights": (
        lambda f: put(f, "filenames.txt", "003.png\n001.png\n"),
        r"3 lights, but filenames\.txt in the same folder has 2",
    ),
    "no names": (lambda f: put(f, "filenames.txt", "\n"), r"filenames\.txt: an empty"),
    "twice": (lambda f: put(f, "filenames.txt", "001.png\n001.png\n"), "listed twice"),
    "names missing": (lambda f: (f / "filenames.txt").unlink(), r"no filenames\.txt"),
    "zero vector": (
        lambda f: put(f, "light_directions.txt", "0 0 1\n0 0 0\n0 0 1\n"),
        r"light_directions\.txt line 2: a zero vector",
    ),
    "mask size": (
        lambda f: write_png(f / "mask.png", np.full((6, 4), 255, np.uint8)),
        r"mask\.png: a mask of 4 x 6",
    ),
    "image size": (
        lambda f: write_png(f / "010.png", np.zeros((5, 6, 3), np.uint16)),
        r"010\.png: 6 x 5 .* 003\.png",
    ),
    "truth size": (
        lambda f: savemat(f / "Normal_gt.mat", {"Normal_gt": NORMALS[:, :5]}),
        r"Normal_gt\.mat: normals of shape \(4, 5, 3\)",
    ),
    "truth missing": (
        lambda f: savemat(f / "Normal_gt.mat", {"N": NORMALS}),
        "no variable Normal_gt",
    ),
    "text": (lambda f: savemat(f / "Normal_gt.mat", {"Normal_gt": "text"}), "Normal_gt"),
    "no mat file": (lambda f: put(f, "Normal_gt.mat", "hello"), "no variable Normal_gt"),
    "empty mat file": (lambda f: put(f, "Normal_gt.mat", ""), "no variable Normal_gt"),
    "mat cut short": (
        lambda f: (f / "Normal_gt.mat").write_bytes((f / "Normal_gt.mat").read_bytes()[:300]),
        "no variable Normal_gt",
    ),
}


@pytest.mark.parametrize(("damage", "match"), DAMAGED_FOLDERS.values(), ids=DAMAGED_FOLDERS)
def test_damaged_folders_are_refused_by_name(folder: Path, damage: object, match: str) -> None:
    damage(folder)  # type: ignore[operator]
    with pytest.raises(DataError, match=match) as caught:
        read_source(folder)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


@needs_data
@pytest.mark.parametrize(
    ("name", "size"), quick([("bearPNG", (273, 230)), ("catPNG", (307, 282))], every=2)
)
def test_real_objects(name: str, size: tuple[int, int]) -> None:
    source = read_source(DATA / "diligent" / name)
    assert len(source.frames) == 96
    assert source.size == size
    assert source.frames[0].read().dtype == np.uint16
    truth, mask = source.normals_truth, source.mask
    assert truth is not None
    assert mask is not None
    np.testing.assert_allclose(np.linalg.norm(truth[mask], axis=1), 1, atol=1e-6)
    # On a convex object seen from the front, the right side faces right and the top faces up.
    rows, columns = np.nonzero(mask)
    assert np.corrcoef(columns, truth[mask][:, 0])[0, 1] > 0.3
    assert np.corrcoef(rows, truth[mask][:, 1])[0, 1] < -0.3

"""Folders that are no recording: every command answers in one line and leaves nothing behind."""

import os
import shutil
import struct
import sys
import zlib

import cv2
import numpy as np
import pytest

from acquisition import write_exr, write_png
from tests.quick_sample import quick
from tests.sgp.conftest import SIZE, ring_lights

HEIC = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(500)
GIF = b"GIF89a" + struct.pack("<HHBBB", 48, 40, 0, 0, 0) + b";"
LP = "\n".join(
    [
        "8",
        *(
            f"ball.{i}.png {x:.4f} {y:.4f} {z:.4f}"
            for i, (x, y, z) in enumerate(ring_lights().unit_directions)
        ),
    ]
)


def only(*names):
    """Keep no image, and write files of these names and bytes."""

    def change(folder):
        for path in folder.iterdir():
            path.unlink()
        for name, data in names:
            (folder / name).write_bytes(data)

    return change


def instead(data):
    """Replace one image by other bytes, under its name."""
    return lambda folder: (folder / "ball.3.png").write_bytes(data)


def link(name, target):
    def change(folder):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(target)

    return change


def folder_of_that_name(folder):
    (folder / "ball.3.png").unlink()
    (folder / "ball.3.png").mkdir()


def pipe(folder):
    (folder / "ball.3.png").unlink()
    os.mkfifo(folder / "ball.3.png")


def subfolder(folder):
    inner = folder / "images"
    inner.mkdir()
    for path in folder.glob("*.png"):
        shutil.move(path, inner)


def huge(folder):
    def chunk(kind, data):
        crc = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + crc

    head = struct.pack(">IIBBBBB", 100_000, 100_000, 16, 0, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(1000))) + chunk(b"IEND", b"")
    (folder / "ball.3.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def cut_jpeg(folder):
    for path in folder.glob("*.png"):
        path.unlink()
    for i in range(8):
        _, data = cv2.imencode(".jpg", np.random.default_rng(i).integers(0, 255, SIZE))
        (folder / f"ball.{i}.jpg").write_bytes(data.tobytes()[: -300 if i == 3 else None])


def floats(folder):
    for path in folder.glob("*.png"):
        path.unlink()
    for i in range(8):
        write_exr(folder / f"ball.{i}.exr", np.full(SIZE, np.nan, np.float32))


def transparent(folder):
    for path in folder.glob("*.png"):
        write_png(path, np.full((*SIZE, 3), 900, np.uint16), alpha=np.zeros(SIZE, bool))


def image(name, pixels):
    return lambda folder: write_png(folder / name, pixels)


def unnumbered(folder):
    for letter, path in zip("abcdefgh", sorted(folder.glob("*.png")), strict=True):
        path.rename(folder / f"{letter}.png")


def series(folder):
    for path in list(folder.glob("*.png")):
        shutil.copy(path, folder / path.name.replace("ball", "cube"))


def lp(text, encoding="utf-8"):
    return lambda folder: (folder / "lights.lp").write_bytes(text.encode(encoding))


def lp_without_an_image(folder):
    lp(LP)(folder)
    (folder / "ball.3.png").unlink()


@pytest.mark.parametrize(
    ("change", "code", "parts"),
    quick(
        [
            pytest.param(only(), 4, ["empty", "choose"], id="empty folder"),
            pytest.param(only(("clip.mp4", b"x")), 4, ["1 video (clip.mp4)"], id="video"),
            pytest.param(
                only(*((f"a.{i}.gif", GIF) for i in range(8))), 4, ["8 GIF images"], id="GIF"
            ),
            pytest.param(
                only(*((f"a.{i}.heic", HEIC) for i in range(8))), 4, ["8 HEIF images"], id="HEIF"
            ),
            pytest.param(only(("notes.txt", b"x")), 4, ["no numbered images"], id="no images"),
            pytest.param(subfolder, 4, ["some in images"], id="folder of folders"),
            pytest.param(unnumbered, 4, ["8 images (a.png)", "number"], id="names without numbers"),
            pytest.param(series, 4, ["ball.#.png", "cube.#.png"], id="two series"),
            pytest.param(instead(b""), 4, ["ball.3.png", "empty: copy"], id="empty file"),
            pytest.param(instead(b"hello world\n" * 20), 4, ["ball.3.png", "is text"], id="text"),
            pytest.param(
                instead(b"<html>404</html>"), 4, ["ball.3.png", "web page"], id="web page"
            ),
            pytest.param(instead(GIF), 4, ["ball.3.png", "a GIF file"], id="GIF renamed"),
            pytest.param(
                instead(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"),
                4,
                ["ball.3.png", "it is a MAT-file"],
                id="MAT-file renamed",
            ),
            pytest.param(instead(HEIC), 4, ["ball.3.png", "a HEIF image"], id="HEIF renamed"),
            pytest.param(instead(bytes(900)), 4, ["ball.3.png", "no supported"], id="zeros"),
            pytest.param(huge, 4, ["ball.3.png", "copy it again"], id="huge header"),
            pytest.param(cut_jpeg, 4, ["ball.3.jpg", "cut short"], id="truncated JPEG"),
            pytest.param(floats, 4, ["ball.0.exr"], id="NaN in EXR"),
            pytest.param(transparent, 4, ["alpha", "no pixel"], id="transparent"),
            pytest.param(
                link("ball.3.png", "gone.png"), 4, ["link to gone.png"], id="dangling link"
            ),
            pytest.param(
                link("ball.3.png", "ball.3.png"), 4, ["ball.3.png: a link"], id="link loop"
            ),
            pytest.param(link("mask.png", "gone.png"), 4, ["link to gone.png"], id="mask link"),
            pytest.param(link("lights.lp", "gone.lp"), 2, ["link to gone.lp"], id="lights link"),
            pytest.param(
                folder_of_that_name, 4, ["ball.3.png", "is a folder"], id="folder as image"
            ),
            pytest.param(
                pipe,
                4,
                ["ball.3.png", "not a regular file"],
                id="pipe",
                marks=pytest.mark.skipif(
                    sys.platform == "win32", reason="Windows has no such files"
                ),
            ),
            pytest.param(
                image("BALL.3.PNG", np.zeros(SIZE, np.uint16)),
                4,
                ["BALL.3.PNG and ball.3.png", "remove"],
                id="names that differ in case",
            ),
            pytest.param(
                image("ball.3.png", np.zeros((40, 47), np.uint16)),
                4,
                ["47 x 40"],
                id="another size",
            ),
            pytest.param(
                image("ball.3.png", np.zeros(SIZE, np.uint8)),
                4,
                ["uint8", "uint16"],
                id="8 and 16 bits",
            ),
            pytest.param(
                image("ball.3.png", np.zeros((*SIZE, 3), np.uint16)),
                4,
                ["RGB"],
                id="grey and colour",
            ),
            pytest.param(lp(LP.replace("8", "12", 1)), 4, ["count is 12"], id="count of lights"),
            pytest.param(lp(LP.replace("0.0000", "nan", 1)), 4, ["lights.lp line"], id="NaN light"),
            pytest.param(lp(""), 4, ["lights.lp", "empty"], id="empty lights"),
            pytest.param(lp(LP, "utf-16"), 4, ["lights.lp", "UTF-8"], id="lights in UTF-16"),
            pytest.param(lp_without_an_image, 4, ["ball.3.png is not"], id="listed, not there"),
        ],
        every=3,
    ),
)
def test_a_bad_folder_gets_one_line(sgp, recording, change, code, parts):
    change(recording)
    out = recording.parent / "out"
    lit = list(recording.glob("*.lp")) or (recording / "lights.lp").is_symlink()
    lights = [] if lit else ["--lights", recording.parent / "lights.json"]
    for words in ("inspect", "normals", "run", "capture import"):
        written = [] if words == "inspect" else ["--out", out]
        line = sgp(*words.split(), recording, *lights, *written).error_line(code)
        for part in (*parts, str(recording)):
            assert part in line
        assert not out.exists()


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(
            lambda text: text.replace(".", ",").replace("ball,", "ball.").replace(",png", ".png"),
            id="decimal commas",
        ),
        pytest.param(lambda text: text.replace("\n", "\r\n"), id="Windows line ends"),
        pytest.param(lambda text: text.replace("\n", "\r"), id="old line ends"),
        pytest.param(lambda text: f"\ufeff{text}", id="byte order mark"),
    ],
)
@pytest.mark.parametrize("name", quick(["ball", "ä ö ball", "two\nlines"], every=3))
def test_unusual_folders_are_read(sgp, recording, change, name):
    folder = recording.rename(recording.with_name(name))
    lp(change(LP))(folder)
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
    answer = sgp("inspect", folder).ok()
    assert "Thumbs.db" in answer.err
    assert "8 images, distant lights" in answer.out

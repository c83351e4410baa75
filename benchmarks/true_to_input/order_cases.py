"""Which image belongs to which light: names of files, and rows of lists."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from true_to_input.case import Outcome, Run, cases, judge, later, sgp
from true_to_input.relief import MASK, directions, error_of, images

from rig.arrays import Floating

_N = 8
_IN_ORDER = [f"IMG_{i:04d}.png" for i in range(1, _N + 1)]


def _write(
    folder: Path, names: Sequence[str], lights: Floating, gains: Floating | None = None
) -> Path:
    """Write an image for each light, in the order in which they were taken, and a mask."""
    source = folder / "src"
    source.mkdir()
    shots = images(lights, scale=0.7)
    for index, (name, shot) in enumerate(zip(names, shots, strict=True)):
        gain = 1.0 if gains is None else gains[index]
        cv2.imwrite(str(source / name), np.round(np.clip(shot * gain, 0, 1) * 65535).astype("u2"))
    cv2.imwrite(str(source / "mask.png"), MASK)
    return source


def _numbers(lights: Floating, digits: int = 6) -> list[str]:
    return [" ".join(f"{value:.{digits}f}" for value in light) for light in lights]


@later
def _folder(
    folder: Path,
    files: Sequence[str] = _IN_ORDER,
    text: Callable[[Floating], str] | None = None,
    file: str = "lights.csv",
    lp: Callable[[Floating], Sequence[str]] | None = None,
    gains: Floating | None = None,
    **judged: Sequence[str],
) -> Outcome:
    """Run `sgp normals` on images with a file of lights, or on a folder with an .lp file.

    A refusal is right only if ``names`` says what it must contain.
    """
    lights = directions(len(files))
    source = _write(folder, files, lights, gains)
    if lp is not None:
        rows = lp(lights)
        (source / "dome.lp").write_text("\n".join([str(len(rows)), *rows]) + "\n", "utf-8")
        words: list[object] = []
    else:
        there = folder / ("lights.txt" if text is None else file)
        there.write_text("\n".join(_numbers(lights)) if text is None else text(lights), "utf-8")
        words = ["--lights", there]
    answer, error = error_of(source, *words)
    if answer.code and "names" not in judged:
        return Outcome("vague", answer.message)
    return judge(answer, error, **judged)


def _wrapped(count: int, first_after: int = 1, digits: int = 4, name: str = "IMG_") -> list[str]:
    turn = count // 2
    last = 10 ** (digits if digits != 5 or name != "DSC" else 4) - 1
    numbers = [last - turn + 1 + i if i < turn else i - turn + first_after for i in range(count)]
    return [f"{name}{number:0{digits}d}.png" for number in numbers]


@later
def _imported(folder: Path, names: Sequence[str], message: Sequence[str] = ()) -> Outcome:
    """Import a folder and compare the LED of each image with its place in the series."""
    from acquisition import Session

    source = _write(folder, names, directions(len(names)))
    out = folder / "session"
    answer = sgp("capture", "import", source, "--out", out)
    if answer.code:
        return judge(answer, names=message)
    leds = {frame.line.origin: frame.led for frame in Session.open(out).frames}
    wrong = [f"{name} is LED {leds[name]}" for led, name in enumerate(names) if leds[name] != led]
    return Outcome("wrong" if wrong else "right", ", ".join(wrong) or "each image has its LED")


@later
def _watched(folder: Path, names: Sequence[str]) -> Outcome:
    """Watch a folder in which the images lie already, with equal times as after copying."""
    import os

    from acquisition import watch_folder
    from acquisition.imports import Watch, lights_in_order

    source = _write(folder, names, directions(len(names)))
    (source / "mask.png").unlink()
    for name in names:
        os.utime(source / name, (1.7e9, 1.7e9))
    watch = Watch(source, lights_in_order(len(names)), settle_s=0.0, timeout_s=1, pair_s=0)
    session = watch_folder(watch, folder / "session").session
    leds = {frame.line.origin: frame.led for frame in session.frames}
    wrong = [
        f"{name} is LED {leds.get(name)}" for led, name in enumerate(names) if leds.get(name) != led
    ]
    return Outcome("wrong" if wrong else "right", ", ".join(wrong) or "each image has its LED")


def _excluded(folder: Path) -> Outcome:
    """Leave out the images 9999 and 1 of a wrapped series, by range."""
    from acquisition import Lights, exclude, read_source

    names = _wrapped(_N)
    source = _write(folder, names, directions(_N))
    left = exclude(read_source(source, lights=Lights(directions(_N))), ["9999-1"]).light_ids
    expected = tuple(name[:-4] for name in names if "9999" not in name and "0001" not in name)
    return Outcome("right" if left == expected else "wrong", f"left: {', '.join(left)}")


def _lp(
    names: Sequence[str], order: Sequence[int] | None = None, extra: Sequence[str] | None = None
) -> Callable[[Floating], list[str]]:
    """Return a function that lists names with their lights, in another order of rows if given."""
    rows = range(len(names)) if order is None else order

    def listed(lights: Floating) -> list[str]:
        texts = _numbers(lights)
        return [f"{names[i]} {texts[i]}{'' if extra is None else f' {extra[i]}'}" for i in rows]

    return listed


def _table(
    row: Callable[[str, Floating], str],
    *heading: str,
    order: Sequence[int] = range(_N),
    end: str = "",
) -> Callable[[Floating], str]:
    """Return a function that writes a row for each image, from its name and its light."""
    return lambda lights: (
        "\n".join([*heading, *(row(_IN_ORDER[i], lights[i]) for i in order)]) + end
    )


def _row(separator: str, *values: str | float) -> str:
    return separator.join(each if isinstance(each, str) else f"{each:.6f}" for each in values)


def _named(separator: str, name: str, light: Floating) -> str:
    return _row(separator, name, *light)


def _german(name: str, light: Floating) -> str:
    return _named(";", name, light).replace(".", ",").replace(",png", ".png")


def _angles(_: str, light: Floating) -> str:
    x, y, z = light
    return f"{np.degrees(np.arctan2(y, x)):.3f},{np.degrees(np.arcsin(z)):.3f},1"


def _whole_csv(folder: Path) -> Outcome:
    """Read vectors of whole numbers: `1,0,1`."""
    from acquisition import read_lights

    path = folder / "lights.csv"
    path.write_text("1,0,1\n0,1,1\n-1,0,1\n0,-1,1\n", "utf-8")
    found = read_lights(path).unit_directions * np.sqrt(2)
    right = np.allclose(found, [[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1]])
    return Outcome("right" if right else "wrong", f"{found.round(3).tolist()}")


def _quoted(folder: Path) -> Outcome:
    """Quote a damaged line as it is."""
    from acquisition import DataError, read_lights

    path = folder / "lights.csv"
    path.write_text("1,0,1\n0,1,up\n", "utf-8")
    try:
        read_lights(path)
    except DataError as error:
        named = "0,1,up" in str(error) and "line 2" in str(error)
        return Outcome("refused by name" if named else "vague", str(error))
    return Outcome("wrong", "read")


def _fifth(count: int, what: str) -> Run:
    rng = np.random.default_rng(0)
    varied = 1 + 0.1 * rng.standard_normal(count)
    values = {
        "intensity": varied,
        "constant": np.ones(count),
        "radius": np.full(count, 450.0),
        "distance": 400 + 40 * rng.standard_normal(count),
    }[what]
    names = [f"img_{i:02d}.png" for i in range(count)]
    gains = varied if what == "intensity" else None
    lp = _lp(names, extra=[f"{value:.3f}" for value in values])
    stated = ["light-column-assumed"]
    return _folder(names, lp=lp, gains=gains, names=["line", "img_00.png"], codes=stated)


def _positions(*, radius_only: bool = False) -> Run:
    """Rows whose vectors are 300 to 500 mm long: directions are right, lengths are stated."""
    lengths = np.full(_N, 450.0) if radius_only else np.linspace(300, 500, _N)
    return _folder(
        lp=lambda lights: [
            f"{name} {x:.2f} {y:.2f} {z:.2f}"
            for name, (x, y, z) in zip(_IN_ORDER, lights * lengths[:, None], strict=True)
        ],
        codes=["light-lengths-unused"],
    )


_ANGLES = "azimuth,elevation,radius"
_SHUFFLED = (3, 0, 7, 5, 1, 6, 2, 4)
_ACCENTED = [unicodedata.normalize("NFC", f"Büste_é{i}.png") for i in range(1, _N + 1)]
_TWO_RUNS = [f"IMG_{i:04d}.png" for i in (9200, 9201, 9202, 9203, 401, 402, 403, 404)]
_BOTH_RUNS = ("IMG_0401", "IMG_9200")
_CLOCKS = [f"20240501_2359{s:02d}.png" for s in (50, 53, 56, 59)]
_CLOCKS += [f"20240502_0000{s:02d}.png" for s in (2, 5, 8, 11)]


def _both(folder: Path) -> Outcome:
    """Two files that a row with another suffix may name."""
    names = [f"a_{i}.png" for i in range(_N)]
    lights = directions(_N)
    source = _write(folder, names, lights)
    for i in range(_N):
        cv2.imwrite(str(source / f"a_{i}.tif"), np.full(MASK.shape, 900 * i + 900, np.uint16))
    rows = [f"a_{i}.jpg {text}" for i, text in enumerate(_numbers(lights))]
    (source / "dome.lp").write_text("\n".join([str(_N), *rows]), "utf-8")
    answer, error = error_of(source)
    return judge(answer, error, names=["a_0.png", "a_0.tif"])


def _other_numbers(numbers: Sequence[int], order: Sequence[int]) -> Run:
    """A list whose numbers contradict those of the files: named row and file."""
    names = [f"light_{number}.jpg" for number in numbers]
    return _folder(lp=_lp(names, order), names=["light_", "IMG_"])


CASES = cases(
    1,
    (
        *((f"wrap{n}", "order 9999, 0001 kept", _folder(_wrapped(n))) for n in (4, 5, 6, 8)),
        ("wrap_import", "LED by order", _imported(_wrapped(_N))),
        (
            "rows_contradict",
            "matched by number",
            _folder(lp=_lp([f"light_{i}.jpg" for i in range(1, _N + 1)], _SHUFFLED)),
        ),
        (
            "names_decomposed",
            "names compared in one Unicode form",
            _folder(
                _ACCENTED,
                lp=_lp([unicodedata.normalize("NFD", name) for name in _ACCENTED], _SHUFFLED),
            ),
        ),
        *(
            (f"lp_fifth_{what}{n}", "used, or row named", _fifth(n, what))
            for n, what in (
                (12, "intensity"),
                (36, "intensity"),
                (36, "constant"),
                (8, "intensity"),
            )
        ),
        ("lp_lengths", "lengths stated as unused", _positions()),
        ("csv_whole", "read", _whole_csv),
        ("csv_quoted", "refused, the line as it is", _quoted),
        ("csv_names", "read", _folder(text=_table(partial(_named, ","), end="\n"))),
        ("csv_plain", "read (control)", _folder(text=_table(lambda _, light: _row(",", *light)))),
    ),
    (
        ("wrap_to_0000", "order 9999, 0000 kept", _folder(_wrapped(_N, 0))),
        ("wrap_of_5_digits", "order 99999, 00001 kept", _folder(_wrapped(_N, 1, 5, "frame"))),
        ("wrap_sony", "order DSC09999, DSC00001 kept", _imported(_wrapped(_N, 1, 5, "DSC"))),
        ("wrap_watch_0000", "order 9999, 0000 kept", _watched(_wrapped(_N, 0))),
        ("wrap_watch_sony", "order DSC09999, DSC00001 kept", _watched(_wrapped(_N, 1, 5, "DSC"))),
        ("wrap_exclude", "9999-1 leaves out two images", _excluded),
        ("two_runs", "refused, both orders named", _folder(_TWO_RUNS, names=_BOTH_RUNS)),
        (
            "two_runs_import",
            "refused, both orders named",
            _imported(_TWO_RUNS, _BOTH_RUNS),
        ),
        (
            "rings",
            "natural order (control)",
            _folder([f"v{i:03d}.png" for i in (1, 2, 3, 4, 101, 102, 103, 104)]),
        ),
        ("clocks_over_midnight", "in order of time", _folder(_CLOCKS)),
        (
            "padding",
            "img_1 is img_01",
            _folder(
                [f"img_{i:02d}.png" for i in range(1, _N + 1)],
                lp=_lp([f"img_{i}.jpg" for i in range(1, _N + 1)], _SHUFFLED),
            ),
        ),
        (
            "offset",
            "0 to 7 are 1 to 8, in order",
            _folder(lp=_lp([f"light_{i}.jpg" for i in range(_N)])),
        ),
        ("offset_shuffled", "refused, row and file named", _other_numbers(range(_N), _SHUFFLED)),
        (
            "row_without_file",
            "refused, row and file named",
            _other_numbers((1, 2, 3, 5, 6, 7, 8, 9), range(_N)),
        ),
        (
            "rows_as_a_browser_sorts",
            "matched by number",
            _folder(
                [f"IMG_{i:04d}.png" for i in range(1, 13)],
                lp=_lp(
                    [f"cap{i}.jpg" for i in range(1, 13)],
                    sorted(range(12), key=lambda i: f"cap{i + 1}.jpg"),
                ),
            ),
        ),
        (
            "windows_folders",
            "matched by name",
            _folder(
                lp=_lp([rf"D:\Dome 2\{name[:-4].lower()}.TIF" for name in _IN_ORDER], _SHUFFLED),
            ),
        ),
        ("suffix_of_two_files", "refused, both named", _both),
        ("lp_fifth_radius", "used, or row named", _fifth(12, "radius")),
        ("lp_fifth_distance", "refused, row named", _fifth(12, "distance")),
        (
            "lp_name_ends_in_number",
            "read (control)",
            _folder(
                [f"img {i}.png" for i in range(1, _N + 1)],
                lp=_lp([f"img {i}" for i in range(1, _N + 1)], _SHUFFLED),
            ),
        ),
        (
            "lp_fifth_without_suffix",
            "used, or row named",
            _folder(
                lp=_lp(
                    [name[:-4] for name in _IN_ORDER], extra=[f"{1 + i / 20}" for i in range(_N)]
                ),
                gains=1 + np.arange(_N) / 20,
                names=["line"],
            ),
        ),
        (
            "lp_rgb",
            "used, or row named",
            _folder(lp=_lp(_IN_ORDER, extra=["1.0 1.0 1.0"] * _N), names=["line 2"]),
        ),
        ("lp_radius", "lengths stated as unused", _positions(radius_only=True)),
        ("csv_semicolons", "read", _folder(text=_table(_german, "file;x;y;z", end="\n"))),
        (
            "csv_tabs",
            "read",
            _folder(text=_table(partial(_named, "\t"), end="\n"), file="lights.tsv"),
        ),
        (
            "csv_columns",
            "columns by their names",
            _folder(text=_table(lambda _, light: _row(",", *light[::-1]), "z,y,x")),
        ),
        (
            "csv_angles",
            "refused, line named",
            _folder(text=_table(_angles, _ANGLES), names=["line 1", _ANGLES]),
        ),
        (
            "csv_index",
            "first column is a number of an image",
            _folder(
                text=_table(
                    lambda name, light: _row(",", f"{int(name[4:8])}", *light), order=_SHUFFLED
                )
            ),
        ),
        *(
            (
                name,
                "matched by the column of names",
                _folder(text=_table(partial(_named, ";"), heading, order=_SHUFFLED, end="\n;;;")),
            )
            for name, heading in (
                ("csv_own_name", "Bild;X;Y;Z"),
                ("csv_image_path", "Image Path;Light X;Light Y;Light Z"),
            )
        ),
        (
            "csv_own_strength",
            "column named as not used",
            _folder(
                text=_table(
                    lambda name, light: _row(",", name, *light, "1.05"), "name,x,y,z,power"
                ),
                codes=["light-column-assumed"],
            ),
        ),
        (
            "names_with_exposures",
            "ordered by the number that differs",
            _folder([f"obj12_L{i:02d}_t{(60, 125, 30)[i % 3]}.png" for i in range(1, _N + 1)]),
        ),
        (
            "names_of_two_days",
            "refused, both series named",
            _folder(
                [f"IMG-2024050{1 + i // 4}-WA{(i + 4) % 8:04d}.png" for i in range(_N)],
                names=["img-20240501-wa#", "img-20240502-wa#"],
            ),
        ),
    ),
)

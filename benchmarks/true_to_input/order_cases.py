"""Which image belongs to which light: names of files, and rows of lists."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from true_to_input.case import Case, Outcome, judge, sgp
from true_to_input.relief import MASK, Array, directions, error_of, images

_N = 8
_IN_ORDER = [f"IMG_{i:04d}.png" for i in range(1, _N + 1)]


def _write(folder: Path, names: Sequence[str], lights: Array, gains: Array | None = None) -> Path:
    """Write an image for each light, in the order in which they were taken, and a mask."""
    source = folder / "src"
    source.mkdir()
    shots = images(lights, scale=0.7)
    for index, (name, shot) in enumerate(zip(names, shots, strict=True)):
        gain = 1.0 if gains is None else gains[index]
        cv2.imwrite(str(source / name), np.round(np.clip(shot * gain, 0, 1) * 65535).astype("u2"))
    cv2.imwrite(str(source / "mask.png"), MASK)
    return source


def _numbers(lights: Array, digits: int = 6) -> list[str]:
    return [" ".join(f"{value:.{digits}f}" for value in light) for light in lights]


def _folder(
    folder: Path,
    files: Sequence[str],
    text: Callable[[Array], str] | None = None,
    file: str = "lights.txt",
    lp: Callable[[Array], Sequence[str]] | None = None,
    gains: Array | None = None,
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
        there = folder / file
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


def _watched(folder: Path, names: Sequence[str]) -> Outcome:
    """Watch a folder in which the images lie already, with equal times as after copying."""
    import os

    from acquisition import Watch, lights_in_order, watch_folder

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
) -> Callable[[Array], list[str]]:
    """Return a function that lists names with their lights, in another order of rows if given."""
    rows = range(len(names)) if order is None else order

    def listed(lights: Array) -> list[str]:
        texts = _numbers(lights)
        return [f"{names[i]} {texts[i]}{'' if extra is None else f' {extra[i]}'}" for i in rows]

    return listed


def _csv(separator: str, heading: str = "", *, comma: bool = False) -> Callable[[Array], str]:
    """Return a function that writes names and vectors with a separator."""

    def written(lights: Array) -> str:
        rows = [
            separator.join([name, *(f"{v:.6f}" for v in light)])
            for name, light in zip(_IN_ORDER, lights, strict=True)
        ]
        rows = [row.replace(".", ",").replace(",png", ".png") if comma else row for row in rows]
        return "\n".join([*([heading] if heading else []), *rows]) + "\n"

    return written


def _plain_csv(lights: Array) -> str:
    return "\n".join(",".join(f"{v:.6f}" for v in light) for light in lights)


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


def _fifth(folder: Path, count: int, what: str) -> Outcome:
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
    return _folder(folder, names, lp=lp, gains=gains, names=["line", "img_00.png"], codes=stated)


def _positions(folder: Path, *, radius_only: bool = False) -> Outcome:
    """Rows whose vectors are 300 to 500 mm long: directions are right, lengths are stated."""
    lengths = np.full(_N, 450.0) if radius_only else np.linspace(300, 500, _N)
    return _folder(
        folder,
        _IN_ORDER,
        lp=lambda lights: [
            f"{name} {x:.2f} {y:.2f} {z:.2f}"
            for name, (x, y, z) in zip(_IN_ORDER, lights * lengths[:, None], strict=True)
        ],
        codes=["light-lengths-unused"],
    )


_SHUFFLED = (3, 0, 7, 5, 1, 6, 2, 4)
_ACCENTED = [unicodedata.normalize("NFC", f"Büste_é{i}.png") for i in range(1, _N + 1)]
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


def _two_runs(folder: Path) -> Outcome:
    names = [f"IMG_{i:04d}.png" for i in (9200, 9201, 9202, 9203, 401, 402, 403, 404)]
    return _folder(folder, names, names=["IMG_0401", "IMG_9200"])


def _other_numbers(folder: Path, numbers: Sequence[int], order: Sequence[int]) -> Outcome:
    """A list whose numbers contradict those of the files: named row and file."""
    names = [f"light_{number}.jpg" for number in numbers]
    return _folder(folder, _IN_ORDER, lp=_lp(names, order), names=["light_", "IMG_"])


CASES = (
    *(
        Case(
            f"wrap{n}",
            1,
            "order 9999, 0001 kept",
            lambda folder, n=n: _folder(folder, _wrapped(n)),
        )
        for n in (4, 5, 6, 8)
    ),
    Case("wrap_import", 1, "LED by order", lambda folder: _imported(folder, _wrapped(_N))),
    Case(
        "rows_contradict",
        1,
        "matched by number",
        lambda folder: _folder(
            folder, _IN_ORDER, lp=_lp([f"light_{i}.jpg" for i in range(1, _N + 1)], _SHUFFLED)
        ),
    ),
    Case(
        "names_decomposed",
        1,
        "names compared in one Unicode form",
        lambda folder: _folder(
            folder,
            _ACCENTED,
            lp=_lp([unicodedata.normalize("NFD", name) for name in _ACCENTED], _SHUFFLED),
        ),
    ),
    *(
        Case(
            f"lp_fifth_{what}{n}",
            1,
            "used, or row named",
            lambda folder, n=n, what=what: _fifth(folder, n, what),
        )
        for n, what in ((12, "intensity"), (36, "intensity"), (36, "constant"), (8, "intensity"))
    ),
    Case("lp_lengths", 1, "lengths stated as unused", _positions),
    Case("csv_whole", 1, "read", _whole_csv),
    Case("csv_quoted", 1, "refused, the line as it is", _quoted),
    Case(
        "csv_names",
        1,
        "read",
        lambda folder: _folder(folder, _IN_ORDER, text=_csv(","), file="lights.csv"),
    ),
    Case(
        "csv_plain",
        1,
        "read (control)",
        lambda folder: _folder(folder, _IN_ORDER, text=_plain_csv, file="lights.csv"),
    ),
    Case(
        "wrap_to_0000",
        1,
        "order 9999, 0000 kept",
        lambda folder: _folder(folder, _wrapped(_N, 0)),
        listed=False,
    ),
    Case(
        "wrap_of_5_digits",
        1,
        "order 99999, 00001 kept",
        lambda folder: _folder(folder, _wrapped(_N, 1, 5, "frame")),
        listed=False,
    ),
    Case(
        "wrap_sony",
        1,
        "order DSC09999, DSC00001 kept",
        lambda folder: _imported(folder, _wrapped(_N, 1, 5, "DSC")),
        listed=False,
    ),
    Case(
        "wrap_watch_0000",
        1,
        "order 9999, 0000 kept",
        lambda folder: _watched(folder, _wrapped(_N, 0)),
        listed=False,
    ),
    Case(
        "wrap_watch_sony",
        1,
        "order DSC09999, DSC00001 kept",
        lambda folder: _watched(folder, _wrapped(_N, 1, 5, "DSC")),
        listed=False,
    ),
    Case("wrap_exclude", 1, "9999-1 leaves out two images", _excluded, listed=False),
    Case("two_runs", 1, "refused, both orders named", _two_runs, listed=False),
    Case(
        "two_runs_import",
        1,
        "refused, both orders named",
        lambda folder: _imported(
            folder,
            [f"IMG_{i:04d}.png" for i in (9200, 9201, 9202, 9203, 401, 402, 403, 404)],
            ["IMG_0401", "IMG_9200"],
        ),
        listed=False,
    ),
    Case(
        "rings",
        1,
        "natural order (control)",
        lambda folder: _folder(folder, [f"v{i:03d}.png" for i in (1, 2, 3, 4, 101, 102, 103, 104)]),
        listed=False,
    ),
    Case(
        "clocks_over_midnight",
        1,
        "in order of time",
        lambda folder: _folder(folder, _CLOCKS),
        listed=False,
    ),
    Case(
        "padding",
        1,
        "img_1 is img_01",
        lambda folder: _folder(
            folder,
            [f"img_{i:02d}.png" for i in range(1, _N + 1)],
            lp=_lp([f"img_{i}.jpg" for i in range(1, _N + 1)], _SHUFFLED),
        ),
        listed=False,
    ),
    Case(
        "offset",
        1,
        "0 to 7 are 1 to 8, in order",
        lambda folder: _folder(folder, _IN_ORDER, lp=_lp([f"light_{i}.jpg" for i in range(_N)])),
        listed=False,
    ),
    Case(
        "offset_shuffled",
        1,
        "refused, row and file named",
        lambda folder: _other_numbers(folder, range(_N), _SHUFFLED),
        listed=False,
    ),
    Case(
        "row_without_file",
        1,
        "refused, row and file named",
        lambda folder: _other_numbers(folder, (1, 2, 3, 5, 6, 7, 8, 9), range(_N)),
        listed=False,
    ),
    Case(
        "rows_as_a_browser_sorts",
        1,
        "matched by number",
        lambda folder: _folder(
            folder,
            [f"IMG_{i:04d}.png" for i in range(1, 13)],
            lp=_lp(
                [f"cap{i}.jpg" for i in range(1, 13)],
                sorted(range(12), key=lambda i: f"cap{i + 1}.jpg"),
            ),
        ),
        listed=False,
    ),
    Case(
        "windows_folders",
        1,
        "matched by name",
        lambda folder: _folder(
            folder,
            _IN_ORDER,
            lp=_lp([rf"D:\Dome 2\{name[:-4].lower()}.TIF" for name in _IN_ORDER], _SHUFFLED),
        ),
        listed=False,
    ),
    Case("suffix_of_two_files", 1, "refused, both named", _both, listed=False),
    Case(
        "lp_fifth_radius",
        1,
        "used, or row named",
        lambda folder: _fifth(folder, 12, "radius"),
        listed=False,
    ),
    Case(
        "lp_fifth_distance",
        1,
        "refused, row named",
        lambda folder: _fifth(folder, 12, "distance"),
        listed=False,
    ),
    Case(
        "lp_name_ends_in_number",
        1,
        "read (control)",
        lambda folder: _folder(
            folder,
            [f"img {i}.png" for i in range(1, _N + 1)],
            lp=_lp([f"img {i}" for i in range(1, _N + 1)], _SHUFFLED),
        ),
        listed=False,
    ),
    Case(
        "lp_fifth_without_suffix",
        1,
        "used, or row named",
        lambda folder: _folder(
            folder,
            _IN_ORDER,
            lp=_lp([name[:-4] for name in _IN_ORDER], extra=[f"{1 + i / 20}" for i in range(_N)]),
            gains=1 + np.arange(_N) / 20,
            names=["line"],
        ),
        listed=False,
    ),
    Case(
        "lp_rgb",
        1,
        "used, or row named",
        lambda folder: _folder(
            folder, _IN_ORDER, lp=_lp(_IN_ORDER, extra=["1.0 1.0 1.0"] * _N), names=["line 2"]
        ),
        listed=False,
    ),
    Case(
        "lp_radius",
        1,
        "lengths stated as unused",
        lambda folder: _positions(folder, radius_only=True),
        listed=False,
    ),
    Case(
        "csv_semicolons",
        1,
        "read",
        lambda folder: _folder(
            folder, _IN_ORDER, text=_csv(";", "file;x;y;z", comma=True), file="lights.csv"
        ),
        listed=False,
    ),
    Case(
        "csv_tabs",
        1,
        "read",
        lambda folder: _folder(folder, _IN_ORDER, text=_csv("\t"), file="lights.tsv"),
        listed=False,
    ),
    Case(
        "csv_columns",
        1,
        "columns by their names",
        lambda folder: _folder(
            folder,
            _IN_ORDER,
            text=lambda lights: (
                "z,y,x\n" + "\n".join(f"{z:.6f},{y:.6f},{x:.6f}" for x, y, z in lights)
            ),
            file="lights.csv",
        ),
        listed=False,
    ),
    Case(
        "csv_angles",
        1,
        "refused, line named",
        lambda folder: _folder(
            folder,
            _IN_ORDER,
            text=lambda lights: (
                "azimuth,elevation,radius\n"
                + "\n".join(
                    f"{np.degrees(np.arctan2(y, x)):.3f},{np.degrees(np.arcsin(z)):.3f},1"
                    for x, y, z in lights
                )
            ),
            file="lights.csv",
            names=["line 1", "azimuth,elevation,radius"],
        ),
        listed=False,
    ),
    Case(
        "csv_index",
        1,
        "first column is a number of an image",
        lambda folder: _folder(
            folder,
            _IN_ORDER,
            text=lambda lights: "\n".join(
                f"{i + 1},{','.join(f'{v:.6f}' for v in lights[i])}" for i in _SHUFFLED
            ),
            file="lights.csv",
        ),
        listed=False,
    ),
    *(
        Case(
            name,
            1,
            "matched by the column of names",
            lambda folder, heading=heading: _folder(
                folder,
                _IN_ORDER,
                text=lambda lights: "\n".join(
                    [
                        heading,
                        *(
                            f"{_IN_ORDER[i]};{';'.join(_numbers(lights[i : i + 1])[0].split())}"
                            for i in _SHUFFLED
                        ),
                        ";;;",
                    ]
                ),
                file="lights.csv",
            ),
            listed=False,
        )
        for name, heading in (
            ("csv_own_name", "Bild;X;Y;Z"),
            ("csv_image_path", "Image Path;Light X;Light Y;Light Z"),
        )
    ),
    Case(
        "csv_own_strength",
        1,
        "column named as not used",
        lambda folder: _folder(
            folder,
            _IN_ORDER,
            text=lambda lights: "\n".join(
                [
                    "name,x,y,z,power",
                    *(
                        f"{n},{x:.6f},{y:.6f},{z:.6f},1.05"
                        for n, (x, y, z) in zip(_IN_ORDER, lights, strict=True)
                    ),
                ]
            ),
            file="lights.csv",
            codes=["light-column-assumed"],
        ),
        listed=False,
    ),
    Case(
        "names_with_exposures",
        1,
        "ordered by the number that differs",
        lambda folder: _folder(
            folder, [f"obj12_L{i:02d}_t{(60, 125, 30)[i % 3]}.png" for i in range(1, _N + 1)]
        ),
        listed=False,
    ),
    Case(
        "names_of_two_days",
        1,
        "refused, both series named",
        lambda folder: _folder(
            folder,
            [f"IMG-2024050{1 + i // 4}-WA{(i + 4) % 8:04d}.png" for i in range(_N)],
            names=["img-20240501-wa#", "img-20240502-wa#"],
        ),
        listed=False,
    ),
)

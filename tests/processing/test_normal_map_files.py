import cv2
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - its own name for itself
import pytest
from scipy.io import loadmat

from acquisition import DataError, MissingPathError, angle_deg, write_exr, write_png
from acquisition.pixels import write_tiff
from processing import NormalMap, read_normals, write_normals
from tests.real_data import DATA, needs_data


def _cap(size=48, radius=0.9):
    """Return the map of a ball, 0 outside."""
    x, y = np.meshgrid(*[(np.arange(size) - (size - 1) / 2) / (size / 2)] * 2)
    z = np.sqrt(np.clip(radius**2 - x * x - y * y, 0, None))
    return NormalMap.from_vectors(np.where(z[..., None] > 0, np.stack([x, -y, z], axis=2), 0))


def _encoded(vectors, top):
    return np.rint((np.asarray(vectors, float) / 2 + 0.5) * top)


def _worst_deg(a, b):
    assert np.array_equal(a.mask, b.mask)
    return angle_deg(a.normals[a.mask], b.normals[b.mask]).max()


def test_written_maps_are_read_unchanged(tmp_path):
    cap = _cap()
    outputs = write_normals(tmp_path, cap)
    assert outputs == {
        "normals": tmp_path / "normals.exr",
        "normals_png": tmp_path / "normals.png",
        "mask": tmp_path / "mask.png",
    }
    for path in (tmp_path, outputs["normals"]):
        normal_map, warnings, _ = read_normals(path)
        assert _worst_deg(normal_map, cap) < 1e-5
        assert warnings == ()
    assert _worst_deg(read_normals(outputs["normals_png"]).normal_map, cap) < 2e-3


def test_the_png_holds_red_right_green_up_blue_toward_the_camera(tmp_path):
    vectors = np.array(
        [[(1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0.6, 0, 0.8), (0, -0.6, 0.8), (0,) * 3]]
    )
    write_normals(tmp_path, NormalMap.from_vectors(vectors))
    stored = cv2.imread(str(tmp_path / "normals.png"), cv2.IMREAD_UNCHANGED)
    assert stored.dtype == np.uint16
    np.testing.assert_array_equal(stored[..., 3], [[65535, 65535, 65535], [65535, 65535, 0]])
    stored = stored[..., 2::-1]
    half = 32768
    expected = [
        [[65535, half, half], [half, 65535, half], [half, half, 65535]],
        [[52428, half, 58982], [half, 13107, 58982], [half, half, 65535]],
    ]
    np.testing.assert_array_equal(stored, expected)
    mask = cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(mask, [[255, 255, 255], [255, 255, 0]])


def test_a_lone_png_keeps_its_mask(tmp_path):
    cap = _cap()
    written = write_normals(tmp_path, cap, "shape")["shape_png"]
    lone = written.rename(tmp_path.parent / f"{tmp_path.name}-lone.png")
    found, warnings, files = read_normals(lone)
    assert _worst_deg(found, cap) < 2e-3  # which compares the masks
    (note,) = warnings
    assert (note.code, note.severity) == ("alpha-is-mask", "info")
    assert files == (lone,)


def test_green_down_inverts_green_in_the_png_only(tmp_path):
    cap = _cap()
    up = write_normals(tmp_path / "up", cap)
    down = write_normals(tmp_path / "down", cap, green="down")
    assert _worst_deg(read_normals(down["normals_png"], green="down").normal_map, cap) < 2e-3
    assert down["normals"].read_bytes() == up["normals"].read_bytes()
    pixels = [cv2.imread(str(of["normals_png"]), -1).astype(int) for of in (up, down)]
    np.testing.assert_array_equal(pixels[0][..., [0, 2, 3]], pixels[1][..., [0, 2, 3]])
    assert np.abs(pixels[0][..., 1] + pixels[1][..., 1] - 65535)[cap.mask].max() <= 1
    assert (pixels[1][~cap.mask] == [65535, 32768, 32768, 0]).all()


def _save(path, values):
    """Write an array in the format of the suffix."""
    write = {".png": write_png, ".tif": write_tiff, ".exr": write_exr, ".npy": np.save}
    write[path.suffix](path, values)
    return path


def _write_rgba(path, cap):
    alpha = np.full((*cap.size, 1), 65535)
    bgr = _encoded(cap.normals, 65535)[..., ::-1]
    cv2.imwrite(str(path), np.concatenate([bgr, alpha], axis=2).astype(np.uint16))


def _words(cap):
    return _encoded(cap.normals, 65535).astype(np.uint16)


def _nan_outside(cap):
    return np.where(cap.mask[..., None], cap.normals, np.nan).astype(np.float64)


LEFT_OUT = "pixels have a NaN or infinite vector and are left out"
FORMATS = {
    "png-16": ("n.png", _words, 2e-3, ""),
    "png-alpha": ("n.png", None, 2e-3, "opaque everywhere"),
    "png-8": ("n.png", lambda cap: _encoded(cap.normals, 255).astype("u1"), 0.5, "0.2 degree"),
    "tiff-16": ("n.tif", _words, 2e-3, ""),
    "exr-vectors": ("n.exr", lambda cap: cap.normals, 1e-5, ""),
    "exr-encoded": ("n.exr", lambda cap: (cap.normals / 2 + 0.5).astype("f4"), 1e-4, ""),
    "npy": ("n.npy", lambda cap: cap.normals, 1e-5, ""),
    "npy-nan-outside": ("n.npy", _nan_outside, 1e-5, LEFT_OUT),
    "npy-uint16": ("n.npy", _words, 2e-3, ""),
}


@pytest.mark.parametrize("form", FORMATS)
def test_every_format_decodes(tmp_path, form):
    name, values, worst_deg, warning = FORMATS[form]
    cap = _cap()
    _save(tmp_path / name, values(cap)) if values else _write_rgba(tmp_path / name, cap)
    normal_map, warnings, _ = read_normals(tmp_path / name)
    assert _worst_deg(normal_map, cap) < worst_deg
    assert len(warnings) == bool(warning)
    assert warning in "".join(map(str, warnings))


def _write_alpha(path, sample, colours, alpha, *, associated=False):
    """Write samples of 0..1 (colours may be vectors) with alpha, unchanged."""
    pixels = np.concatenate([colours, alpha[..., None]], axis=2).astype(np.float32)
    if path.suffix == ".npy":
        np.save(path, pixels)
        return
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 4, sample)
    if not associated:
        spec.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec)
    assert file.write_image(pixels)
    assert file.close()


ALPHA_FILES = [
    pytest.param("n.png", oiio.UINT8, True, False, 0.8, id="png-8"),
    pytest.param("n.png", oiio.UINT16, True, False, 5e-3, id="png-16"),
    pytest.param("n.tif", oiio.UINT16, True, False, 5e-3, id="tiff"),
    pytest.param("n.tif", oiio.UINT16, True, True, 5e-3, id="tiff-premultiplied"),
    pytest.param("n.tif", oiio.UINT8, True, True, 1.5, id="tiff-8-premultiplied"),
    pytest.param("n.exr", oiio.FLOAT, False, False, 1e-4, id="exr-vectors"),
    pytest.param("n.exr", oiio.FLOAT, False, True, 1e-4, id="exr-vectors-premultiplied"),
    pytest.param("n.exr", oiio.FLOAT, True, False, 1e-4, id="exr-encoded"),
    pytest.param("n.exr", oiio.FLOAT, True, True, 1e-4, id="exr-encoded-premultiplied"),
    pytest.param("n.npy", None, False, False, 1e-4, id="npy"),
]


@pytest.mark.parametrize(("name", "sample", "encoded", "multiplied", "worst_deg"), ALPHA_FILES)
def test_alpha_is_the_mask(tmp_path, name, sample, encoded, multiplied, worst_deg):
    """The alpha channel has a soft edge, and the normals outside it must not count."""
    full = NormalMap.from_vectors(np.where(_cap().mask[..., None], _cap().normals, (0, 0, 1.0)))
    columns = np.broadcast_to(np.arange(48), (48, 48))
    alpha = np.clip((columns - 10.2) / 8, 0, 1)
    colours = full.normals / 2 + 0.5 if encoded else full.normals
    if multiplied:
        colours = colours * alpha[..., None]
    _write_alpha(tmp_path / name, sample, colours, alpha, associated=multiplied)
    normal_map, notes, files = read_normals(tmp_path / name)
    inside = alpha > 0.5
    assert np.array_equal(normal_map.mask, inside)
    assert angle_deg(normal_map.normals[inside], full.normals[inside]).max() < worst_deg
    assert f"alpha channel is the mask, {inside.sum()} of 2304 pixels" in str(notes[0])
    assert files == (tmp_path / name,)


@pytest.mark.parametrize("named", [False, True], ids=["in-folder", "named"])
def test_a_mask_file_overrides_alpha(tmp_path, named):
    cap = _cap()
    alpha = np.zeros(cap.size)
    alpha[:, :9] = 1
    _write_alpha(tmp_path / "n.png", oiio.UINT16, cap.normals / 2 + 0.5, alpha)
    mask = tmp_path / ("other.png" if named else "mask.png")
    write_png(mask, cap.mask.astype(np.uint8) * 255)
    normal_map, notes, _ = read_normals(tmp_path / "n.png", mask_path=mask if named else None)
    assert np.array_equal(normal_map.mask, cap.mask)
    assert _worst_deg(normal_map, cap) < 2e-3
    (note,) = notes
    assert str(note) == f"{tmp_path / 'n.png'}: the alpha channel is ignored, the mask is {mask}"


def test_alpha_with_nothing_inside_is_refused(tmp_path):
    _write_alpha(tmp_path / "n.png", oiio.UINT16, _cap().normals / 2 + 0.5, np.full((48, 48), 0.4))
    with pytest.raises(DataError, match=r"n\.png: the alpha channel is below half"):
        read_normals(tmp_path / "n.png")


def test_jpeg_decodes(tmp_path):
    x, y = np.meshgrid(np.linspace(-3, 3, 64), np.linspace(-3, 3, 64))
    relief = NormalMap.from_vectors(np.stack([np.sin(x), 0.5 * np.cos(y), 0 * x + 1], axis=2))
    bgr = _encoded(relief.normals, 255)[..., ::-1].astype(np.uint8)
    cv2.imwrite(str(tmp_path / "n.jpg"), bgr, [cv2.IMWRITE_JPEG_QUALITY, 95])
    normal_map, warnings, _ = read_normals(tmp_path / "n.jpg")
    assert _worst_deg(normal_map, relief) < 4
    assert [one.code for one in warnings] == ["normals-encoding", "normals-8-bit"]
    assert "0.4 degree" in str(warnings[1])


@pytest.mark.parametrize("background", [0, 32768, 65535], ids=["black", "grey", "white"])
def test_painted_backgrounds_are_outside(tmp_path, background):
    cap = _cap(radius=0.5)
    pixels = np.where(cap.mask[..., None], _encoded(cap.normals, 65535), background)
    write_png(tmp_path / "n.png", pixels.astype(np.uint16))
    assert np.array_equal(read_normals(tmp_path / "n.png").normal_map.mask, cap.mask)


def test_a_mask_in_the_folder_and_a_named_mask(tmp_path):
    cap = _cap()
    in_folder, named = cap.mask.copy(), cap.mask.copy()
    in_folder[:, :20], named[:20] = False, False
    np.save(tmp_path / "n.npy", cap.normals)
    write_png(tmp_path / "mask.png", np.where(in_folder, 200, 100).astype(np.uint8))
    write_png(tmp_path / "other.png", np.where(named, 65535, 0).astype(np.uint16))
    assert np.array_equal(read_normals(tmp_path / "n.npy").normal_map.mask, in_folder)
    other = read_normals(tmp_path / "n.npy", mask_path=tmp_path / "other.png")
    assert np.array_equal(other.normal_map.mask, named)


def test_pixels_of_the_mask_without_a_normal_are_reported(tmp_path):
    cap = _cap()
    vectors = cap.normals.copy()
    vectors[20:22, 20:23] = 0
    np.save(tmp_path / "normal_map.npy", vectors)
    write_png(tmp_path / "mask.png", cap.mask.astype(np.uint8) * 255)
    normal_map, warnings, _ = read_normals(tmp_path)
    assert not normal_map.mask[20:22, 20:23].any()
    assert len(warnings) == 1
    assert "6 pixels of the mask" in str(warnings[0])


def test_normals_that_face_away_are_reported(tmp_path):
    np.save(tmp_path / "n.npy", -_cap().normals)
    (warning,) = read_normals(tmp_path / "n.npy").warnings
    assert warning.code == "normals-face-away"


@pytest.mark.parametrize(
    ("channels", "named"), [((2, 1, 0), "red"), ((0, 2, 1), "green"), ((1, 2, 0), "green")]
)
def test_z_in_another_channel_is_named(tmp_path, channels, named):
    np.save(tmp_path / "n.npy", _cap().normals[..., channels])
    (warning,) = read_normals(tmp_path / "n.npy").warnings
    assert warning.code == "normals-channels-swapped"
    assert f"{named} and blue seem to be swapped" in warning.text


@pytest.mark.parametrize(
    "tilt", [(0.9, 0.1, 0.2), (-0.9, 0.1, 0.2), (0.1, 0.9, 0.2), (0.1, 0.1, 1)]
)
def test_planes_do_not_show_swapped_channels(tmp_path, tilt):
    """All components of a tilted plane have one sign."""
    noise = np.random.default_rng(3).normal(scale=0.02, size=(40, 40, 3))
    vectors = np.array(tilt) + noise
    np.save(tmp_path / "n.npy", vectors / np.linalg.norm(vectors, axis=2, keepdims=True))
    assert read_normals(tmp_path / "n.npy").warnings == ()


def _with_mask(mask):
    def write(path):
        np.save(path / "n.npy", _cap().normals)
        write_png(path / "mask.png", mask.astype(np.uint8) * 255)
        return path / "n.npy"

    return write


def _bytes(name, data):
    def write(path):
        (path / name).write_bytes(data)
        return path / name

    return write


def _array(array, name="n.npy"):
    return lambda path: _save(path / name, array)


def _archive(path):
    np.savez(path / "n.npz", a=np.zeros(3))
    return (path / "n.npz").rename(path / "n.npy")


PHOTOGRAPH = np.random.default_rng(0).uniform(0, 255, (40, 40, 3)) * np.array([1, 0.8, 0.5])


@pytest.mark.parametrize(
    ("write", "message"),
    [
        pytest.param(_array(PHOTOGRAPH.astype("u1"), "n.png"), "not a normal", id="photograph"),
        pytest.param(_array(np.full((9, 9), 90, "u1"), "n.png"), "three channels", id="grey"),
        pytest.param(_with_mask(np.zeros((48, 48), bool)), "nothing inside", id="mask-of-zeros"),
        pytest.param(_with_mask(np.ones((48, 49), bool)), "mask of 49 x 48", id="mask-size"),
        pytest.param(_bytes("n.png", b"\x89PNG\r\n\x1a\n"), "n.png", id="truncated-png"),
        pytest.param(_bytes("n.npy", b"\x93NUMPY\x01"), "n.npy", id="truncated-npy"),
        pytest.param(_bytes("n.npy", b""), "n.npy", id="empty-npy"),
        pytest.param(_bytes("n.exr", b"not an image"), "n.exr", id="text"),
        pytest.param(_array(np.zeros((5, 5, 3))), "not a normal map", id="zeros"),
        pytest.param(_array(np.full((5, 5, 3), np.nan)), "not a normal map", id="nan"),
        pytest.param(_array(np.zeros((5, 5, 3), complex)), "complex", id="complex"),
        pytest.param(_array(np.zeros((5, 5, 2))), "three channels", id="two-channels"),
        pytest.param(_array(np.array([{}])), "n.npy", id="pickled"),
        pytest.param(_archive, "not a readable array", id="archive"),
        pytest.param(lambda path: path, "no normals in this folder", id="empty-folder"),
    ],
)
def test_an_unreadable_file_gives_one_line(tmp_path, write, message):
    with pytest.raises(DataError, match=message) as raised:
        read_normals(write(tmp_path))
    assert "\n" not in str(raised.value)


def test_missing_paths(tmp_path):
    with pytest.raises(MissingPathError, match="nowhere"):
        read_normals(tmp_path / "nowhere")
    np.save(tmp_path / "n.npy", _cap().normals)
    with pytest.raises(MissingPathError, match=r"m\.png"):
        read_normals(tmp_path / "n.npy", mask_path=tmp_path / "m.png")


@needs_data
@pytest.mark.parametrize(
    ("folder", "lowest_z", "warned"),
    [
        ("owl", -0.99, True),
        ("plant", -0.9, False),
        ("stripes", 0.7, False),
        ("tent", 0.7, False),
        *[
            (f"diligent/{name}", -0.01, False)
            for name in ("bear", "buddha", "cat", "cow", "goblet")
        ],
    ],
)
def test_real_maps_face_the_camera(folder, lowest_z, warned):
    folder = DATA / "normals" / folder
    normal_map, warnings, _ = read_normals(folder)
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    assert np.array_equal(normal_map.mask, mask)
    z = normal_map.normals[mask][:, 2]
    assert z.mean() > 0.6
    assert z.min() >= lowest_z
    assert bool(warnings) == warned
    # Without the mask file the same pixels are inside, except for a few at the border.
    alone, _, _ = read_normals(folder / "normal_map.png")
    assert np.array_equal(alone.mask, mask)


@needs_data
@pytest.mark.parametrize("name", ["151", "160", "188"])
def test_real_jpeg_reliefs_fill_their_frame(name):
    path = DATA / "reliefs" / f"{name}.jpg"
    normal_map, warnings, _ = read_normals(path)
    assert normal_map.mask.all()
    assert normal_map.normals[..., 2].mean() > 0.7
    assert "8-bit" in str(warnings[0])


@needs_data
@pytest.mark.parametrize("name", ["bear", "cat"])
def test_decoded_maps_equal_the_truth_of_the_same_objects(name):
    data = DATA
    normal_map, _, _ = read_normals(data / "normals" / "diligent" / name)
    truth = loadmat(data / "diligent" / f"{name}PNG" / "Normal_gt.mat")["Normal_gt"]
    valid = np.linalg.norm(truth, axis=2) > 0.5

    def corner(mask):
        return np.array([np.flatnonzero(mask.any(axis=1))[0], np.flatnonzero(mask.any(axis=0))[0]])

    # The maps are cropped differently, and their masks are one pixel narrower.
    rows, columns = np.nonzero(normal_map.mask)
    down, right = corner(valid) - corner(normal_map.mask) + 1
    theirs = truth[rows + down, columns + right]
    assert len(rows) > 0.97 * np.count_nonzero(valid)
    assert angle_deg(normal_map.normals[rows, columns], theirs).max() < 0.01


def test_a_result_contains_its_normals(tmp_path):
    cap = _cap()
    write_normals(tmp_path / "normals", cap)
    read = read_normals(tmp_path)
    assert _worst_deg(read.normal_map, cap) < 1e-5
    assert read.files == (tmp_path / "normals/normals.exr", tmp_path / "normals/mask.png")
    # What is in the folder itself comes first.
    write_normals(tmp_path, _cap(32))
    assert read_normals(tmp_path).normal_map.size == (32, 32)

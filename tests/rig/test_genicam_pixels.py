"""Pixel formats: samples packed as the standard specifies, decoded by the camera's code."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rig import CameraError
from rig.genicam.pixels import PixelFormat, best_format, decode

FORMATS = [
    f"{kind}{depth}"
    for kind in ("Mono", "BayerRG", "BayerGR", "BayerGB", "BayerBG")
    for depth in ("8", "10", "12", "14", "16", "10p", "12p", "10Packed", "12Packed")
]


def bits_of(values, depth):
    """Return the bits of values, least significant bit first."""
    return [value >> bit & 1 for value in values for bit in range(depth)]


def bytes_of(bits):
    bits = bits + [0] * (-len(bits) % 8)
    return bytes(
        sum(bit << place for place, bit in enumerate(bits[at : at + 8]))
        for at in range(0, len(bits), 8)
    )


def packed_as_gige_vision(values, depth):
    low = depth - 8
    out = bytearray()
    for first in range(0, len(values), 2):
        one = values[first]
        other = values[first + 1] if first + 1 < len(values) else 0
        out.append(one >> low)
        out.append(one & ((1 << low) - 1) | (other & ((1 << low) - 1)) << 4)
        out.append(other >> low)
    return bytes(out)


def pack(values, form, *, big_endian=False):
    """Pack a run of samples into bytes as the standard specifies."""
    if form.packing == "p":
        return bytes_of(bits_of(values, form.depth))
    if form.packing == "Packed":
        return packed_as_gige_vision(values, form.depth)
    order = "big" if big_endian else "little"
    return b"".join(value.to_bytes(1 if form.depth == 8 else 2, order) for value in values)


@st.composite
def images(draw):
    form = PixelFormat.of(draw(st.sampled_from(FORMATS)))
    height, width = draw(st.integers(1, 5)), draw(st.integers(1, 9))
    values = st.lists(
        st.integers(0, 2**form.depth - 1), min_size=height * width, max_size=height * width
    )
    return form, np.array(draw(values)).reshape(height, width)


@given(images(), st.integers(0, 5), st.booleans())
def test_padded_rows_are_decoded_exactly(image, padding, big_endian):
    form, values = image
    if padding == 0 and form.packing:
        # If both layouts have the same number of bytes, joined rows are assumed.
        assume(form.bytes_of(values.size) != len(values) * form.bytes_of(values.shape[1]))
    rows = [pack(row, form, big_endian=big_endian) + b"\xa5" * padding for row in values.tolist()]
    pixels = decode(b"".join(rows), form, size=values.shape, padding=padding, big_endian=big_endian)
    assert pixels.dtype == np.uint16
    assert np.array_equal(pixels, values)


@given(images())
def test_rows_that_begin_within_a_byte_are_decoded_exactly(image):
    form, values = image
    pixels = decode(pack(values.ravel().tolist(), form), form, size=values.shape)
    assert np.array_equal(pixels, values)


def test_pixels_are_a_copy():
    raw = bytearray(range(12))
    pixels = decode(bytes(raw), PixelFormat.of("Mono8"), size=(3, 4))
    again = decode(memoryview(raw), PixelFormat.of("Mono8"), size=(3, 4))
    raw[:] = bytes(12)
    assert np.array_equal(again, pixels)
    assert pixels.flags.writeable
    assert pixels.flags.c_contiguous


@pytest.mark.parametrize(
    ("name", "size", "padding", "count"),
    [
        pytest.param("Mono8", (4, 5), 0, 19, id="a byte short"),
        pytest.param("Mono12", (4, 5), 0, 20, id="half"),
        pytest.param("Mono12p", (4, 5), 0, 29, id="packed, a byte short of joined rows"),
        pytest.param("Mono12p", (4, 5), 0, 31, id="packed, between joined and separate rows"),
        pytest.param("Mono12p", (4, 5), 0, 33, id="packed, ambiguous"),
        pytest.param("Mono8", (4, 5), 2, 27, id="padding missing"),
        pytest.param("Mono16", (4, 5), 0, 0, id="nothing"),
    ],
)
def test_a_buffer_of_a_wrong_size_is_refused_with_the_sizes(name, size, padding, count):
    with pytest.raises(CameraError, match=rf"camera c7: a {name} frame of 5 x 4 .* has {count};"):
        decode(bytes(count), PixelFormat.of(name), size=size, padding=padding, camera="c7")


@pytest.mark.parametrize(
    ("name", "size", "padding"),
    [
        pytest.param("Mono8", (4, 5), 0, id="bytes"),
        pytest.param("Mono12p", (4, 6), 0, id="packed rows of whole bytes"),
        pytest.param("Mono12p", (4, 5), 3, id="packed and padded"),
    ],
)
def test_bytes_after_the_image_are_ignored(name, size, padding):
    form = PixelFormat.of(name)
    values = np.arange(size[0] * size[1]).reshape(size)
    raw = b"".join(pack(row, form) + bytes(padding) for row in values.tolist())
    assert np.array_equal(decode(raw + b"\xff" * 40, form, size=size, padding=padding), values)


@pytest.mark.parametrize("depth", [10, 12, 14])
def test_samples_in_the_high_bits_are_refused(depth):
    bright = 2**depth - 1 - np.arange(20, dtype="<u2")
    raw = (bright << (16 - depth)).tobytes()
    with pytest.raises(CameraError, match=rf"Mono{depth} frame does not fit into {depth} bits"):
        decode(raw, PixelFormat.of(f"Mono{depth}"), size=(4, 5))


@pytest.mark.parametrize(
    "name",
    ["RGB8", "RGBa8", "BGR8", "YUV422_8", "Mono8s", "Mono14p", "Mono16p", "Mono8p", "Mono1p",
     "BayerRG14p", "Mono", "Mono12pp", "mono8", "Coord3D_C16", ""],
)  # fmt: skip
def test_formats_that_are_not_raw_samples_are_unknown(name):
    assert PixelFormat.of(name) is None


@pytest.mark.parametrize(
    ("offered", "best"),
    [
        pytest.param(("Mono8", "Mono10", "Mono12", "Mono12p"), "Mono12", id="12 bits, not packed"),
        pytest.param(("Mono8", "Mono12Packed", "Mono16"), "Mono12Packed", id="12 before 16"),
        pytest.param(("Mono8", "RGB8", "Mono16"), "Mono16", id="16 before 8"),
        pytest.param(("Mono16", "BayerGB8", "RGB8"), "BayerGB8", id="raw colour before mono"),
        pytest.param(("RGBa8", "Mono8"), "Mono8", id="mono if colour is not raw"),
        pytest.param(("RGB8", "YUV422_8"), None, id="none"),
        pytest.param((), None, id="nothing offered"),
    ],
)
def test_the_best_format_is_chosen(offered, best):
    assert best_format(offered) == best


@pytest.mark.parametrize(
    ("name", "cfa"),
    [("BayerRG12p", "RGGB"), ("BayerGR8", "GRBG"), ("BayerGB10Packed", "GBRG"),
     ("BayerBG16", "BGGR"), ("Mono12", None)],
)  # fmt: skip
def test_the_colours_are_those_of_the_name(name, cfa):
    assert PixelFormat.of(name).cfa == cfa

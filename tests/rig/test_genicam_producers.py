"""GenTL producers of other vendors, and files that are not producers."""

import os
import shutil
import time
import zipfile
from pathlib import Path

import genicam
import pytest

from rig import CameraError
from rig.genicam import find_cameras, open_genicam

VIKY = Path(genicam.__file__).parent / "viky.cti"


@pytest.fixture(scope="module")
def tlsimu(tmp_path_factory):
    """The simulator that the genicam wheel had up to 1.5.0, in a folder with the files it needs."""
    wheel = os.environ.get("SGP_GENICAM_1_5")
    if not wheel:
        pytest.skip(
            "SGP_GENICAM_1_5 does not name the genicam 1.5.0 wheel: `make genicam-1.5` fetches it"
        )
    folder = Path(wheel)
    if folder.is_file():
        folder = tmp_path_factory.mktemp("genicam-1.5.0")
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(folder)
    return next(folder.rglob("TLSimu.cti"))


def grab(cti, serial, needs, count=2):
    camera = open_genicam(cti, serial=serial, pixel_format="Mono8", needs=needs)
    try:
        camera.arm()
        return camera.info, [camera.fetch(camera.trigger(), 10.0) for _ in range(count)]
    finally:
        camera.close()


def test_viky_is_enumerated():
    assert [camera.serial for camera in find_cameras([VIKY])] == ["0", "1", "2"]
    assert {camera.model for camera in find_cameras([VIKY])} == {"Viky"}


@pytest.mark.parametrize("serial", ["0", "1", "2"])
def test_viky_is_grabbed_from(serial):
    info, frames = grab(VIKY, serial, needs=())
    assert (info.width, info.height, info.pixel_format) == (400, 400, "Mono8")
    assert [frame.frame_id for frame in frames] == [0, 1]
    for frame in frames:
        assert frame.pixels.shape == (400, 400)
        # A ball on a white ground.
        assert len(set(frame.pixels.ravel().tolist())) > 1
        assert frame.pixels.max() == 255


def grab_ahead(cti, serial, needs, most_bytes, pairs, apart_s=0.0):
    """Take several frames at once; return them and the number of buffers."""
    camera = open_genicam(
        cti, serial=serial, pixel_format="Mono8", needs=needs, most_bytes=most_bytes
    )
    try:
        camera.arm("software", 37)
        frames = []
        for _ in range(pairs):
            ids = [camera.trigger()]
            time.sleep(apart_s)
            ids.append(camera.trigger())
            frames += [camera.fetch(frame_id, 10.0) for frame_id in ids]
        return frames, camera._acquisition.counts()["buffers"]
    finally:
        camera.close()


ROOMS = [
    pytest.param(None, 39, id="a buffer for each"),
    pytest.param(1_000_000, 4, id="a thread empties them"),
]


@pytest.mark.parametrize(("most_bytes", "buffers"), ROOMS)
def test_viky_gets_room_for_a_sequence(most_bytes, buffers):
    frames, announced = grab_ahead(VIKY, "0", (), most_bytes, 2)
    assert announced == buffers
    assert [frame.frame_id for frame in frames] == list(range(4))
    assert all(frame.pixels.max() == 255 for frame in frames)


@pytest.mark.parametrize(("most_bytes", "buffers"), ROOMS)
def test_tlsimu_gets_room_for_a_sequence(tlsimu, most_bytes, buffers):
    # It ignores triggers while it exposes.
    frames, announced = grab_ahead(tlsimu, "SN_InterfaceA_0", ("trigger",), most_bytes, 4, 0.3)
    assert announced == buffers
    assert [frame.frame_id for frame in frames] == list(range(8))
    # Its clock restarts every second.
    assert len({frame.timestamp_ns for frame in frames}) == 8


def test_viky_lacks_the_nodes_for_a_rig():
    with pytest.raises(CameraError, match="lacks nodes: ExposureTime, TriggerMode, TriggerSource"):
        open_genicam(VIKY, serial="0")


def test_two_cameras_of_one_producer_are_open_at_once_and_no_others_are_lost():
    first = open_genicam(VIKY, serial="0", pixel_format="Mono8", needs=())
    second = open_genicam(VIKY, serial="2", pixel_format="Mono8", needs=())
    first.arm()
    second.arm()
    assert first.fetch(first.trigger(), 10.0).pixels.shape == (400, 400)
    first.close()
    assert len(find_cameras([VIKY])) == 3
    assert second.fetch(second.trigger(), 10.0).pixels.shape == (400, 400)
    again = open_genicam(VIKY, serial="0", pixel_format="Mono8", needs=())
    again.arm()
    assert again.fetch(again.trigger(), 10.0).pixels.shape == (400, 400)
    second.close()
    again.close()


def test_one_of_several_cameras_must_be_named():
    with pytest.raises(
        CameraError, match=r"3 cameras found, choose one by serial number: 0 \(.*, 1 \("
    ):
        open_genicam(VIKY)
    with pytest.raises(CameraError, match=r"no camera 17; found: 0 \("):
        open_genicam(VIKY, serial="17")


def test_tlsimu_is_enumerated(tlsimu):
    assert [camera.serial for camera in find_cameras([tlsimu])] == [
        "SN_InterfaceA_0",
        "SN_InterfaceA_1",
        "SN_InterfaceB_0",
        "SN_InterfaceB_1",
    ]


@pytest.mark.parametrize("serial", ["SN_InterfaceA_0", "SN_InterfaceB_0"])
@pytest.mark.parametrize("needs", [(), ("trigger",)], ids=["free", "triggered"])
def test_tlsimu_is_grabbed_from(tlsimu, serial, needs):
    info, frames = grab(tlsimu, serial, needs, 4)
    assert (info.model, info.width, info.height) == ("TLSimuMono", 512, 512)
    assert [frame.frame_id for frame in frames] == [0, 1, 2, 3]
    # Its clock restarts every second.
    assert len({frame.timestamp_ns for frame in frames}) == 4
    for frame in frames:
        assert frame.pixels.shape == (512, 512)
        assert set(frame.pixels.ravel().tolist()) == set(range(256))


def test_tlsimu_sends_colour_although_mono_is_set_and_this_is_an_error(tlsimu):
    with pytest.raises(CameraError, match=r"768 x 572 pixels in RGB8, but .* in Mono8 was set"):
        grab(tlsimu, "SN_InterfaceA_1", ("trigger",))


def test_several_producers_are_searched(tlsimu):
    assert len(find_cameras([VIKY, tlsimu])) == 7
    open_genicam([VIKY, tlsimu], serial="SN_InterfaceB_0", needs=(), pixel_format="Mono8").close()


def cut(data):
    return data[: len(data) // 2]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        pytest.param(lambda path: None, "no such GenTL producer; give the path", id="missing"),
        pytest.param(Path.mkdir, "cannot be read", id="a folder"),
        pytest.param(Path.touch, "not a GenTL producer", id="empty"),
        pytest.param(lambda path: path.write_text("<cti/>"), "not a GenTL producer", id="text"),
        pytest.param(lambda path: path.write_bytes(cut(VIKY.read_bytes())), "is cut short",
                     id="cut short"),
        pytest.param(lambda path: path.write_bytes(VIKY.read_bytes()[:70]), "is cut short",
                     id="cut to its header"),
        pytest.param(lambda path: path.write_bytes(VIKY.read_bytes()[:64] + bytes(10**6)),
                     "not a GenTL producer", id="zeros"),
        pytest.param(lambda path: path.write_bytes(b"GCInitLib\0" * 99), "cannot be loaded",
                     id="the name alone"),
        pytest.param(lambda path: shutil.copy(next(VIKY.parent.glob("libLog*.so")), path),
                     "not a GenTL producer", id="another library"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_a_producer_is_refused_in_one_line(make, message, tmp_path):
    path = tmp_path / "camera.cti"
    make(path)
    for use in (open_genicam, lambda cti: find_cameras([cti])):
        with pytest.raises(CameraError, match=message) as error:
            use(path)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)


def test_a_bad_file_among_good_ones_leaves_the_good_ones_usable(tmp_path):
    with pytest.raises(CameraError, match="no such GenTL producer"):
        open_genicam([VIKY, tmp_path / "none.cti"], serial="0")
    assert len(find_cameras([VIKY])) == 3

"""Kernels run wherever the program is installed, and whatever happens to their files."""

import os
import stat
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

from rig.kernels import KernelWatch, kernel_folder, private_folder, watch_kernels
from rig.kernels.cache import _adapt
from rig.kernels.numba_cache import _KernelCache

ROOT = Path(__file__).parents[2]


def double(x):
    return 2 * x


class Watch(KernelWatch):
    def __init__(self):
        self.reasons = []
        self.active = []

    def compiling(self, active):
        self.active.append(active)

    def uncached(self, reason):
        self.reasons.append(reason)


@pytest.fixture
def watch(monkeypatch):
    watch = Watch()
    monkeypatch.setattr("rig.kernels.threads._State.watch", watch)
    monkeypatch.setattr("rig.kernels.threads._State.stated", False)
    return watch


@pytest.fixture
def kernel(monkeypatch, tmp_path):
    """Return a function that decorates a kernel again, as another process would."""
    monkeypatch.setattr(numba.core.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(double, "__module__", "rig.kernels")

    def decorated():
        dispatcher = numba.njit(cache=True)(double)
        assert isinstance(dispatcher._cache, _KernelCache)
        return dispatcher

    return decorated


def files(tmp_path, suffix=".nb[ci]"):
    return sorted((tmp_path / "cache").rglob(f"*{suffix}"))


def test_a_kernel_is_compiled_once(kernel, watch, tmp_path):
    assert kernel()(4) == 8
    assert watch.active == [1, 0]
    assert len(files(tmp_path)) == 2
    assert kernel()(4) == 8
    assert watch.active == [1, 0]
    assert watch.reasons == []


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda data: b"", id="empty"),
        pytest.param(lambda data: data[:40], id="cut"),
        pytest.param(lambda data: bytes(255 - byte for byte in data), id="inverted"),
    ],
)
def test_damaged_files_are_replaced(kernel, watch, tmp_path, suffix, damage):
    assert kernel()(4) == 8
    (path,) = files(tmp_path, suffix)
    path.write_bytes(damage(path.read_bytes()))
    assert kernel()(4) == 8
    assert watch.active == [1, 0, 1, 0]
    assert kernel()(4) == 8
    assert len(watch.active) == 4


def test_a_flipped_bit_of_machine_code_is_noticed(kernel, watch, tmp_path):
    assert kernel()(4) == 8
    (path,) = files(tmp_path, ".nbc")
    data = bytearray(path.read_bytes())
    for place in range(0, len(data), len(data) // 7):
        path.write_bytes(data[:place] + bytes([data[place] ^ 8]) + data[place + 1 :])
        before = len(watch.active)
        assert kernel()(4) == 8
        assert len(watch.active) == before + 2


def test_a_full_disk_is_stated_once(kernel, watch, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_index", full)
    for _ in range(2):
        assert kernel()(4) == 8
    (reason,) = watch.reasons
    assert "No space left on device" in reason
    assert "NUMBA_CACHE_DIR" in reason


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="of Unix")
class TestPrivateFolder:
    @pytest.fixture(autouse=True)
    def _temporary(self, monkeypatch, tmp_path):
        self.place = tmp_path / "tmp"
        self.place.mkdir()
        self.path = self.place / f"sgp-{os.geteuid()}"
        monkeypatch.setenv("TMPDIR", str(self.place))

    def test_it_is_made_for_its_user(self):
        for _ in range(2):
            assert private_folder() == self.path
            assert stat.S_IMODE(self.path.stat().st_mode) == 0o700

    def test_one_that_others_can_write_is_not_used(self):
        self.path.mkdir()
        self.path.chmod(0o770)
        assert private_folder() != self.path

    def test_a_link_is_not_used(self, tmp_path):
        (tmp_path / "elsewhere").mkdir(0o700)
        self.path.symlink_to(tmp_path / "elsewhere")
        assert private_folder() != self.path

    def test_a_file_is_not_used(self):
        self.path.write_text("")
        assert private_folder() != self.path

    def test_it_is_not_made_where_others_can_replace_it(self):
        self.place.chmod(0o777)
        assert private_folder() != self.path
        self.place.chmod(0o1777)
        assert private_folder() == self.path

    def test_one_of_another_user_is_not_used(self, monkeypatch):
        self.path.mkdir(0o700)
        user = os.geteuid()
        monkeypatch.setattr(os, "geteuid", lambda: user + 1)
        self.path.rename(self.place / f"sgp-{user + 1}")
        assert private_folder() != self.place / f"sgp-{user + 1}"


def test_functions_of_other_programs_keep_numbas_cache(kernel, monkeypatch):
    monkeypatch.setattr(double, "__module__", "someone_else")
    assert type(numba.njit(cache=True)(double)._cache) is numba.core.caching.FunctionCache


@pytest.mark.parametrize("first", ["numba", "rig", "processing.maps.metrics"])
def test_the_order_of_imports_does_not_matter(first):
    code = (
        f"import {first}, processing.maps.metrics as m\n"
        "kernels = [k for k in vars(m).values() if getattr(k, 'targetoptions', {}).get('nogil')]\n"
        "assert kernels\n"
        "assert all(type(k._cache).__name__ == '_KernelCache' for k in kernels)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_the_folder_of_the_kernels_is_known(monkeypatch, tmp_path):
    monkeypatch.setattr(numba.core.config, "CACHE_DIR", str(tmp_path))
    folder = kernel_folder()
    assert folder is not None
    assert folder.parent == tmp_path
    watch_kernels(KernelWatch())


def test_another_layout_of_numba_keeps_its_own_cache(monkeypatch):
    monkeypatch.setitem(sys.modules, "rig.kernels.numba_cache", None)
    dispatcher = SimpleNamespace(FunctionCache=object)
    _adapt(dispatcher)
    assert dispatcher.FunctionCache is object


def test_a_cache_that_this_numba_cannot_make_is_numbas_own(monkeypatch):
    monkeypatch.setattr("rig.kernels.numba_cache.count_compilations", lambda: None)
    monkeypatch.setattr("rig.kernels.numba_cache.cache_of", lambda _: 1 / 0)
    dispatcher = SimpleNamespace(FunctionCache=lambda function: "numba's own")
    _adapt(dispatcher)
    assert dispatcher.FunctionCache(private_folder) == "numba's own"

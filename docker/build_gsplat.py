"""Compile gsplat's CUDA kernels into its installed package, where it looks for them first (`gsplat.csrc`).

The wheel on PyPI brings sources only and compiles them at first use, which needs nvcc; an image that runs has none.
TORCH_CUDA_ARCH_LIST names the GPUs, so none has to be there while this runs.
"""

from __future__ import annotations

import importlib.util
import tempfile
from pathlib import Path

from torch.utils.cpp_extension import load


def main() -> None:
    """Build `csrc` beside gsplat's modules."""
    spec = importlib.util.find_spec("gsplat")
    if spec is None or spec.origin is None:
        raise SystemExit("gsplat is not installed: install streamlod[cuda] first")
    package = Path(spec.origin).parent
    sources = package / "cuda"
    with tempfile.TemporaryDirectory() as folder:
        load(
            name="csrc",
            sources=[str(path) for pattern in ("csrc/*.cu", "csrc/*.cpp", "ext.cpp") for path in sources.glob(pattern)],
            extra_include_paths=[str(sources / "include"), str(sources / "csrc" / "third_party" / "glm")],
            extra_cflags=["-O3", "-Wno-attributes"],
            extra_cuda_cflags=["-O3", "-use_fast_math"],
            build_directory=folder,
            is_python_module=False,
            verbose=True,
        )
        (package / "csrc.so").write_bytes((Path(folder) / "csrc.so").read_bytes())


if __name__ == "__main__":
    main()

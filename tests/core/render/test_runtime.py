"""The process's settings are in place before torch and numba load, and give way to the user's."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from streamlod.core import runtime

NAMES = ("OMP_WAIT_POLICY", "GOMP_SPINCOUNT", "NUMBA_THREADING_LAYER", "NUMBA_CACHE_DIR")


def settings_after_import(**given: str) -> dict[str, str]:
    clean = {key: value for key, value in os.environ.items() if key not in NAMES}
    code = f"import core, os; print('\\n'.join(os.environ.get(n, '') for n in {NAMES!r}))"
    answer = subprocess.run(
        [sys.executable, "-c", code], env={**clean, **given}, check=True, capture_output=True, text=True
    ).stdout
    return dict(zip(NAMES, answer.splitlines(), strict=True))


def test_importing_core_sets_them(tmp_path: Path) -> None:
    found = settings_after_import(XDG_CACHE_HOME=str(tmp_path))
    assert found["OMP_WAIT_POLICY"] == "PASSIVE"
    assert found["GOMP_SPINCOUNT"] == "1000"
    assert found["NUMBA_THREADING_LAYER"] == "omp"
    assert Path(found["NUMBA_CACHE_DIR"]).parent == tmp_path / "streamlod" / "numba"


def test_what_the_user_set_stays() -> None:
    given = {"OMP_WAIT_POLICY": "ACTIVE", "NUMBA_THREADING_LAYER": "tbb", "NUMBA_CACHE_DIR": "/elsewhere"}
    assert settings_after_import(**given) == given | {"GOMP_SPINCOUNT": ""}
    given |= {"OMP_WAIT_POLICY": "PASSIVE", "GOMP_SPINCOUNT": "7"}
    assert settings_after_import(**given) == given


def test_kernels_take_as_many_threads_as_were_asked_for() -> None:
    """And torch, whose number a kernel of more threads would raise."""
    code = (
        "import streamlod.core, numba, numpy, torch\nfrom numba import njit, prange\n"
        "@njit(parallel=True)\ndef double(x):\n for i in prange(len(x)):\n  x[i] *= 2\n"
        "double(numpy.ones(8))\nprint(numba.get_num_threads(), torch.get_num_threads())"
    )
    clean = {key: value for key, value in os.environ.items() if key != "NUMBA_NUM_THREADS"}
    for asked in ("1", "1,4"):
        answer = subprocess.run(
            [sys.executable, "-c", code],
            env=clean | {"OMP_NUM_THREADS": asked},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        assert answer.split() == ["1", "1"]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["read-only", "full", "no folder"])
def test_kernels_compile_where_no_cache_can_be_kept(tmp_path: Path, kind: str) -> None:
    """One sentence says so, and everything works; Numba itself would end with a traceback."""
    folder = tmp_path / "cache"
    folder.mkdir()
    if kind == "no folder":
        folder = Path("/proc/nothing")
    else:
        mount = ["mount", "-t", "tmpfs", "-o", "ro" if kind == "read-only" else "size=16k", "none", str(folder)]
        if subprocess.run(mount, capture_output=True, check=False).returncode:
            pytest.skip("no disk can be mounted here")
    code = (
        "import streamlod.core\nfrom numba import njit\nfrom tests.core.render.test_runtime import doubled\n"
        "print(njit(cache=True)(doubled)(21))"
    )
    environment = {key: value for key, value in os.environ.items() if key not in NAMES}
    environment |= {"XDG_CACHE_HOME": str(folder), "HOME": str(folder)}
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
        )
    finally:
        if kind != "no folder":
            subprocess.run(["umount", "-l", str(folder)], check=True)
    assert (done.stdout, done.returncode) == ("42\n", 0), done.stderr
    assert done.stderr.count("compiled kernels cannot be kept") == 1
    assert "Traceback" not in done.stderr


def doubled(number: int) -> int:
    return 2 * number


def test_whatever_kernels_are_compiled_from_is_found(tmp_path: Path) -> None:
    files = {
        "core/kernels.py": "import numba\nfrom streamlod.core import rules\n@numba.njit()\ndef f(): ...\n",
        "core/rules.py": "from streamlod.core.deep.numbers import ONE\n",
        "core/deep/numbers.py": "ONE = 1\n",
        "core/caller.py": "from streamlod.core.kernels import f\n",
        "codec/coder/rans.py": "from streamlod.codec.coder.compiled import compiled\n"
        "from streamlod.codec import tables\n",
        "codec/coder/compiled.py": "from numba import njit\njit = njit()\n",
        "codec/tables.py": "",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = set(runtime.kernel_sources(tmp_path))
    assert found == {
        *("streamlod.core.kernels", "streamlod.core.rules", "streamlod.core.deep.numbers"),
        *("streamlod.codec.coder.rans", "streamlod.codec.coder.compiled", "streamlod.codec.tables"),
    }


def test_every_compiled_function_lies_in_a_kernel_source() -> None:
    found = runtime.kernel_sources(Path(runtime.__file__).parents[1])
    assert {
        "streamlod.core.render.cpu.kernels.inline.simd",
        "streamlod.core.scene.entropy_model",
        "streamlod.codec.coder.rans",
    } <= set(found)
    assert "streamlod.core.errors" not in found  # whatever many import would renew the whole cache with each change
    assert "streamlod.core.train.trainer" not in found


def test_a_changed_kernel_gets_a_new_cache_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    before = runtime.kernel_cache_folder()
    assert runtime.kernel_cache_folder() == before
    monkeypatch.setattr(runtime, "kernel_sources", lambda root: {"core.kernels": b"other"})
    assert runtime.kernel_cache_folder() != before

"""The directions in which parts may depend on each other, read from the source, and proved in a fresh process."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("core", "codec", "server", "client")
ALLOWED = {
    "core": {"core"},
    "codec": {"codec", "core"},
    "server": {"server", "codec", "core"},
    "client": {"client", "codec", "core"},
}
# Sub-packages and modules from the ground up: each imports from itself and from those before it. The command line
# stands on the server and the client, and nothing imports it.
LAYERS = {
    "core": (
        "close_codes errors field_faults arrays files gaps masking runtime background_log repeating version options"
        " progress_bar web_address",
        "camera", "frames", "scene", "render metrics data synthetic initialise", "train calibration",
    ),
    "core.train": (
        "setting config pictures kernels control progress", "optimise loss", "field", "growth motion",
        "keyframe later_frame", "paper engine", "presets", "trainer",
    ),
    "server": (
        "protocol doctor", "ingest", "pipeline", "settings", "auth worker http", "stream", "viewer",
        "api", "edge", "service", "cli",
    ),
    "server.ingest": (
        "sync board_sight", "sound", "cameras", "finding", "statistics ahead watch small_jpeg findings holders",
        "knocks poses walk clap", "rig", "push", "live recording", "showing",
    ),
    "client": (
        "recording events viewpoints recorder rest_answers", "rest playback", "connection",
        "inspection viewing", "evaluation", "commands", "remote",
    ),
}  # fmt: skip
COMMAND_LINE = "server.cli"  # may import any package
# Pairs of sub-packages of which one imports the other. More of them make a package hard to take in.
MAX_ARROWS = {"core": 40, "core.train": 52, "server": 39, "client": 20}
MAX_FILES = 16  # of a folder: fifteen and __init__.py
HEAVY = {"torch", "fastapi", "uvicorn", "pydantic", "sklearn", "scipy", "gsplat"}
LIGHT_CLIENT = {
    "playback",
    "link",
    "edges",
    "moving_link",
    "watch",
    "viewpoints",
    "recorder",
    "recording",
    "take",
    "record",
    "events",
    "inspection",
}
GUARDED_UNPICKLER = "core/metrics/lpips_weights.py"  # reads arrays from published weights, refuses all else
MAX_LINES = 600  # of a file; aim for 120, argue for 400
PATHS = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(parse(path)))


def local(module: str) -> str:
    """A module's name inside the repository: its folder is `core`, its installed name `streamlod.core`."""
    return module.removeprefix("streamlod.")


def imports(path: Path) -> Iterator[str]:
    """Modules that a file imports, anywhere in it."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (local(alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield local(node.module or "")


def packages(path: Path) -> set[str]:
    """Top-level packages that a file imports."""
    return {module.split(".")[0] for module in imports(path)}


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_imports_point_downwards() -> None:
    upward = {}
    for path in PATHS:
        allowed = ALLOWED[path.relative_to(ROOT).parts[0]]
        allowed = allowed | ({"client"} if module_of(path).startswith(COMMAND_LINE) else set())
        upward[name_of(path)] = packages(path) & {*PACKAGES, "tests"} - allowed
    assert {name: found for name, found in upward.items() if found} == {}


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in PATHS}


def arrows_of(path: Path) -> Iterator[str]:
    """Modules of the project that a file imports, at its top, inside functions, or by a string such as "a.b:c"."""
    for node in nodes(path):
        if isinstance(node, ast.Import):
            yield from (local(alias.name) for alias in node.names if local(alias.name) in MODULES)
        elif isinstance(node, ast.ImportFrom) and (module := local(node.module or "")) in MODULES:
            members = [f"{module}.{alias.name}" for alias in node.names]
            yield from (member if member in MODULES else module for member in members)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = local(node.value.split(":")[0])
            if name in MODULES and "." in name:
                yield name


@cache
def arrows() -> dict[str, set[str]]:
    """The modules of the project that each module imports."""
    return {name: {target for target in arrows_of(path) if target != name} for name, path in MODULES.items()}


def parts_of(package: str) -> dict[str, str]:
    """The sub-package, or module at the top, that each module of a package belongs to."""
    return {name: name.removeprefix(package + ".").split(".")[0] for name in MODULES if name.startswith(package + ".")}


@pytest.mark.parametrize("package", LAYERS)
def test_sub_packages_import_downwards(package: str) -> None:
    floor = {name: number for number, names in enumerate(LAYERS[package]) for name in names.split()}
    inside = parts_of(package)
    assert set(inside.values()) <= set(floor), "name the floor of every part in LAYERS"
    upward = [
        f"{name} -> {target}"
        for name, part in inside.items()
        for target in arrows()[name] & inside.keys()
        if floor[inside[target]] > floor[part]
    ]
    assert upward == []


@pytest.mark.parametrize("package", MAX_ARROWS)
def test_sub_packages_know_few_others(package: str) -> None:
    inside = parts_of(package)
    pairs = {(inside[name], inside[target]) for name in inside for target in arrows()[name] & inside.keys()}
    assert len({(part, other) for part, other in pairs if part != other}) <= MAX_ARROWS[package]


def test_modules_do_not_import_each_other_in_circles() -> None:
    left = {name: set(targets) for name, targets in arrows().items()}
    while free := [name for name, targets in left.items() if not targets & left.keys()]:
        for name in free:
            del left[name]
    assert left == {}


def test_folders_stay_small() -> None:
    counts = {name_of(folder): len(list(folder.glob("*.py"))) for folder in {path.parent for path in PATHS}}
    assert {name: count for name, count in counts.items() if count > MAX_FILES} == {}


def is_ground_floor(path: Path) -> bool:
    parts = path.relative_to(ROOT).parts
    return (
        (parts[0] == "core" and len(parts) == 2)
        or parts[0] == "codec"
        or (parts[0] == "client" and path.stem in LIGHT_CLIENT)
    )


def test_the_ground_floor_needs_no_training_library() -> None:
    heavy = {name_of(path): packages(path) & HEAVY for path in PATHS if is_ground_floor(path)}
    assert {name: found for name, found in heavy.items() if found} == {}


@pytest.mark.parametrize(
    "module",
    [
        "codec.encoder",
        "codec.export",
        "client.viewing.record",
        "core.train.presets.settings",
        "server.pipeline.checks",
        "server.cli.main",
    ],
)
def test_light_modules_stay_light_in_a_fresh_process(module: str) -> None:
    forbidden = (HEAVY - {"scipy"}) | (
        {"numba", "numpy", "httpx", "av", "cv2"} if module == "server.cli.main" else set()
    )
    # Numba loads scipy on its own where it is installed.
    code = f"import sys, streamlod.{module}; print(*sorted({forbidden!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_commands_that_only_read_need_no_training_library() -> None:
    """`info`, `view` and `export`, in an image that only plays."""
    code = f"import sys; sys.modules |= dict.fromkeys({HEAVY!r}); import streamlod.client.commands"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def calls(path: Path) -> set[str]:
    """Functions that a file calls by a plain name."""
    found = (node.func for node in nodes(path) if isinstance(node, ast.Call))
    return {function.id for function in found if isinstance(function, ast.Name)}


def test_libraries_do_not_print() -> None:
    assert [name_of(path) for path in PATHS if "print" in calls(path)] == []


def test_logging_is_configured_by_the_command_line_alone() -> None:
    configuring = [name_of(path) for path in PATHS if "basicConfig" in path.read_text(encoding="utf-8")]
    assert configuring == ["server/cli/main.py"]


def test_nothing_unpickles_or_evaluates() -> None:
    for path in PATHS:
        unpickling = packages(path) & {"pickle", "marshal", "shelve", "dill"}
        assert not unpickling or name_of(path) == GUARDED_UNPICKLER, path
        assert not calls(path) & {"eval", "exec"}, path


def test_files_stay_short() -> None:
    lengths = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in PATHS}
    assert {name: count for name, count in lengths.items() if count > MAX_LINES} == {}


def test_no_two_public_classes_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for path in PATHS:
        for node in nodes(path):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(name_of(path))
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}

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
        "close_codes errors arrays files runtime",
        "camera", "frames", "scene", "render metrics data synthetic initialise", "train",
    ),
    "core.train": (
        "config paper presets pictures kernels control", "optimise", "field", "growth motion", "keyframe residual",
        "refresh", "progress", "trainer",
    ),
    "server": (
        "protocol doctor", "ingest", "pipeline", "settings", "auth worker http", "stream", "viewer", "registry",
        "api", "edge", "service", "cli",
    ),
    "server.ingest": ("sync cameras", "push", "statistics ahead metrics", "rig", "live"),
    "client": (
        "recording events viewpoints recorder rest_answers", "rest playback", "connection", "inspection viewing",
        "evaluation", "commands", "remote",
    ),
}  # fmt: skip
COMMAND_LINE = "server.cli"  # may import any package
MAX_FILES = 16  # of a folder: fifteen and __init__.py
HEAVY = {"torch", "fastapi", "uvicorn", "pydantic", "sklearn", "scipy", "gsplat"}
LIGHT_CLIENT = {
    "playback",
    "connection",
    "viewpoints",
    "recorder",
    "recording",
    "viewing",
    "events",
    "inspection",
}
GUARDED_UNPICKLER = "core/metrics/lpips_weights.py"  # reads arrays from published weights, refuses all else
LONGEST_FILE = 600  # aim for 120, argue for 400
PATHS = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> Iterator[str]:
    """Modules that a file imports, anywhere in it."""
    waiting: list[ast.AST] = [parse(path)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module or ""
        waiting.extend(ast.iter_child_nodes(node))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", PATHS, ids=name_of)
def test_imports_point_downwards(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    found = {module.split(".")[0] for module in imports(path)}
    allowed = ALLOWED[package] | ({"client"} if module_of(path).startswith(COMMAND_LINE) else set())
    assert not (found & set(PACKAGES)) - allowed
    assert "tests" not in found


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_of(path): path for path in PATHS}


def arrows_of(path: Path) -> Iterator[str]:
    """Modules of the project that a file imports, at its top, inside functions, or by a string such as "a.b:c"."""
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in MODULES)
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            members = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (member if member in MODULES else node.module for member in members)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = node.value.split(":")[0]
            if name in MODULES and "." in name:
                yield name


ARROWS = {name: {target for target in arrows_of(path) if target != name} for name, path in MODULES.items()}


@pytest.mark.parametrize("package", LAYERS)
def test_sub_packages_import_downwards(package: str) -> None:
    floor = {name: number for number, names in enumerate(LAYERS[package]) for name in names.split()}
    inside = {
        name: name.removeprefix(package + ".").split(".")[0] for name in MODULES if name.startswith(package + ".")
    }
    assert set(inside.values()) <= set(floor), "name the floor of every part in LAYERS"
    upward = [
        f"{name} -> {target}"
        for name, part in inside.items()
        for target in ARROWS[name] & inside.keys()
        if floor[inside[target]] > floor[part]
    ]
    assert upward == []


def test_modules_do_not_import_each_other_in_circles() -> None:
    arrows = {name: set(targets) for name, targets in ARROWS.items()}
    while free := [name for name, targets in arrows.items() if not targets & arrows.keys()]:
        for name in free:
            del arrows[name]
    assert arrows == {}


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


@pytest.mark.parametrize("path", [path for path in PATHS if is_ground_floor(path)], ids=name_of)
def test_the_ground_floor_needs_no_training_library(path: Path) -> None:
    found = {module.split(".")[0] for module in imports(path)}
    assert not found & HEAVY


@pytest.mark.parametrize(
    "module",
    [
        "codec.encoder",
        "codec.export",
        "client.viewing",
        "server.cli.main",
    ],
)
def test_light_modules_stay_light_in_a_fresh_process(module: str) -> None:
    forbidden = (HEAVY - {"scipy"}) | (
        {"numba", "numpy", "client", "av", "cv2"} if module == "server.cli.main" else set()
    )
    # Numba loads scipy on its own where it is installed.
    code = f"import sys, {module}; print(*sorted({forbidden!r} & {{name.split('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize("path", PATHS, ids=name_of)
def test_libraries_do_not_print(path: Path) -> None:
    calls = [node for node in ast.walk(parse(path)) if isinstance(node, ast.Call)]
    assert not [node.lineno for node in calls if isinstance(node.func, ast.Name) and node.func.id == "print"]


@pytest.mark.parametrize("path", PATHS, ids=name_of)
def test_logging_is_configured_by_the_command_line_alone(path: Path) -> None:
    if name_of(path) != "server/cli/main.py":
        assert "basicConfig" not in path.read_text(encoding="utf-8")


def test_nothing_unpickles_or_evaluates() -> None:
    for path in PATHS:
        found = {module.split(".")[0] for module in imports(path)}
        assert not found & {"pickle", "marshal", "shelve", "dill"} or name_of(path) == GUARDED_UNPICKLER, path
        calls = [node for node in ast.walk(parse(path)) if isinstance(node, ast.Call)]
        names = {node.func.id for node in calls if isinstance(node.func, ast.Name)}
        assert not names & {"eval", "exec"}, path


def test_files_stay_short() -> None:
    lengths = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in PATHS}
    assert {name: count for name, count in lengths.items() if count > LONGEST_FILE} == {}


def test_no_two_public_classes_share_a_name() -> None:
    homes: dict[str, list[str]] = {}
    for path in PATHS:
        for node in ast.walk(parse(path)):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(name_of(path))
    assert {name: paths for name, paths in homes.items() if len(paths) > 1} == {}

"""The shape of the package: which way imports flow, what every method has, and pages that say what the code says."""

import ast
import runpy
from pathlib import Path

import pytest

import framecast
from framecast.methods import METHODS

PACKAGE = Path(framecast.__file__).parent
ROOT = PACKAGE.parent

LEVELS = {
    "exr": 0,
    "frame": 0,
    "color": 1,
    "warp": 1,
    "flip": 1,
    "video": 1,
    "packing": 1,
    "resample": 1,
    "table": 1,
    "nets": 1,
    "losses": 1,
    "weights": 1,
    "recipe": 1,
    "sample": 2,
    "stages": 2,
    "clip": 2,
    "labels": 2,
    "methods": 2,
    "runtime": 3,
    "importers": 3,
    "data": 3,
    "metrics": 3,
    "regions": 3,
    "render": 4,
    "fit": 4,
    "provenance": 4,
    "results": 4,
    "checkpoint": 4,
    "constants": 5,
    "export_clip": 5,
    "upsample": 5,
    "train": 5,
    "evaluate": 5,
    "cost": 5,
    "bench": 5,
    "campaign": 5,
    "page": 5,
    "report": 6,
    "doctor": 5,
    "demo": 6,
    "commands": 6,
    "cli": 7,
    "__main__": 7,
}


def imports(path: Path) -> set[str]:
    """Top-level modules of the package that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("framecast"):
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
        if isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("framecast.")}
    return found - {"__version__"}


def owner(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


FILES = [p for p in sorted(PACKAGE.rglob("*.py")) if owner(p) not in ("__init__", "shaders")]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_flow_one_way(path: Path) -> None:
    here = owner(path)
    for module in imports(path) - {here, "shaders"}:
        assert LEVELS[module] <= LEVELS[here], f"{here} imports {module}"


def test_methods_know_no_files_and_the_renderer_knows_no_methods() -> None:
    for path in FILES:
        if owner(path) == "methods":
            assert not imports(path) & {"clip", "importers", "exr"}, path
        if owner(path) == "render":
            assert not imports(path) & {"methods", "runtime", "evaluate"}, path


def test_files_stay_readable() -> None:
    longest = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in FILES}
    assert max(longest.values()) <= 500, max(longest, key=longest.__getitem__)


def test_every_method_is_in_the_readme() -> None:
    readme = (ROOT / "README.md").read_text()
    assert [name for name in METHODS if f"`{name}`" not in readme] == []


def test_the_conventions_page_is_what_the_code_says() -> None:
    page = runpy.run_path(str(ROOT / "docs" / "conventions.py"))["page"]()
    assert (ROOT / "docs" / "conventions.md").read_text() == page, "run: make docs"

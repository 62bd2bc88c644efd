"""Who may import whom, and what `import sfsnet_dr` costs."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import sfsnet_dr

PACKAGE = Path(sfsnet_dr.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))

#: Each part may import itself and what stands before it.
ORDER = [
    "base", "sh", "scene", "render", "data", "model", "loss", "metrics", "fit", "apply", "report", "study",
    "commands", "cli", "__main__",
]  # fmt: skip

#: Folders in which a heavy library may be imported, and single files with their reason.
HEAVY = {
    # runtime chooses libLLVM and the variant; doctor's job is to see whether they start.
    "mitsuba": {"scene", "render", "base/runtime.py", "study/doctor.py"},
    "drjit": {"scene", "render", "loss", "base/runtime.py", "study/doctor.py"},
}

#: Seconds that `import sfsnet_dr` may take, from the project's requirements.
LONGEST_IMPORT = 0.3


def imported(path: Path) -> Iterator[str]:
    """Every module name that a file imports anywhere, functions included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def part_of(module: str) -> str | None:
    """The part of the package that a module belongs to; None for other packages and the root."""
    names = module.split(".")
    return names[1] if names[0] == "sfsnet_dr" and len(names) > 1 and names[1] in ORDER else None


def against_the_order(importer: str, modules: Iterator[str]) -> list[str]:
    """The modules that a part must not import."""
    allowed = ORDER[: ORDER.index(importer) + 1]
    return [m for m in modules if (part := part_of(m)) is not None and part not in allowed]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_run_one_way(path: Path) -> None:
    importer = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    if importer == "__init__":
        assert not list(imported(path)) or set(imported(path)) == {"__future__.annotations"}
    else:
        assert against_the_order(importer, imported(path)) == []


@pytest.mark.parametrize("library", HEAVY)
def test_heavy_libraries_stay_where_they_belong(library: str) -> None:
    strangers = []
    for path in FILES:
        place = path.relative_to(PACKAGE)
        if place.parts[0] in HEAVY[library] or place.as_posix() in HEAVY[library]:
            continue
        if any(module.split(".")[0] == library for module in imported(path)):
            strangers.append(place.as_posix())
    assert strangers == []


def test_the_check_sees_a_wrong_import(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("def f():\n    from sfsnet_dr.study import demo\n    import sfsnet_dr.fit.trainer\n")
    assert against_the_order("base", imported(wrong)) == ["sfsnet_dr.study.demo", "sfsnet_dr.fit.trainer"]
    assert against_the_order("study", imported(wrong)) == []


def test_every_part_is_in_the_order() -> None:
    parts = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in FILES} - {"__init__"}
    assert parts <= set(ORDER)


def test_packages_hold_a_docstring_and_no_code() -> None:
    for path in PACKAGE.glob("*/__init__.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert ast.get_docstring(tree), path
        assert len(tree.body) == 1, path


def test_import_is_quick_and_light() -> None:
    code = (
        "import sys, time; begin = time.perf_counter(); import sfsnet_dr; "
        "took = time.perf_counter() - begin; "
        "print(took, *(m for m in ('numpy', 'torch', 'mitsuba', 'drjit') if m in sys.modules))"
    )
    answers = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(5)
    ]
    assert all(len(answer) == 1 for answer in answers), answers
    assert min(float(answer[0]) for answer in answers) < LONGEST_IMPORT


def test_help_loads_no_renderer_and_no_network() -> None:
    code = (
        "import sys; from sfsnet_dr.cli import main; main([]); "
        "print([m for m in ('torch', 'mitsuba', 'drjit', 'colour', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"

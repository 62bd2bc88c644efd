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
    "core", "sh", "scene", "render", "metrics", "data", "models", "losses", "train", "estimation",
    "inference", "report", "experiments", "api", "cli", "__main__",
]  # fmt: skip

#: Folders in which a heavy library may be imported, and single files with their reason.
HEAVY = {
    # runtime chooses libLLVM and the variant; doctor's job is to see whether they start.
    "mitsuba": {"scene", "render", "core/runtime.py", "experiments/doctor.py"},
    "drjit": {"scene", "render", "losses", "core/runtime.py", "experiments/doctor.py"},
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
        assert list(imported(path)) == ["lazy_loader"]
    else:
        assert against_the_order(importer, imported(path)) == []


def modules_imported(path: Path, names: set[str]) -> set[str]:
    """The package's own modules that a file imports, lazy and TYPE_CHECKING imports included."""
    found = set()
    for module in imported(path):
        for name in (module, module.rpartition(".")[0]):
            if name in names:
                found.add(name)
                break
    return found


def import_cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other (strongly connected components of two or more)."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        stack = list(graph[start])
        while stack:
            name = stack.pop()
            if name not in seen:
                seen.add(name)
                stack.extend(graph[name])
        reach[start] = seen
    groups = {tuple(sorted({a, *(b for b in reach[a] if a in reach[b])})) for a in graph if a in reach[a]}
    return [list(group) for group in sorted(groups)]


def test_no_module_imports_itself_through_others() -> None:
    names = {".".join(("sfsnet_dr", *p.relative_to(PACKAGE).with_suffix("").parts)): p for p in FILES}
    names = {name.removesuffix(".__init__"): path for name, path in names.items()}
    graph = {name: modules_imported(path, set(names)) - {"sfsnet_dr"} for name, path in names.items()}
    assert import_cycles(graph) == []


def test_the_check_sees_a_cycle() -> None:
    assert import_cycles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


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
    wrong.write_text(
        "def f():\n    from sfsnet_dr.experiments import demo\n    import sfsnet_dr.train.trainer\n"
    )
    assert against_the_order("core", imported(wrong)) == [
        "sfsnet_dr.experiments.demo",
        "sfsnet_dr.train.trainer",
    ]
    assert against_the_order("experiments", imported(wrong)) == []


def test_every_part_is_in_the_order() -> None:
    parts = {path.relative_to(PACKAGE).parts[0].removesuffix(".py") for path in FILES} - {"__init__"}
    assert parts <= set(ORDER)


def test_packages_hold_a_docstring_and_no_code_but_their_lazy_names() -> None:
    for path in PACKAGE.rglob("__init__.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        assert ast.get_docstring(tree), path
        if path.with_suffix(".pyi").exists():
            assert list(imported(path)) == ["lazy_loader"], path
        else:
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
        "import sys; from sfsnet_dr.cli.main import main; main([]); "
        "print([m for m in ('torch', 'mitsuba', 'drjit', 'colour', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"

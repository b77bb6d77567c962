"""Who may import whom, where no import contract says it, and other rules of the source."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import grimp
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def test_no_files_import_one_another_in_a_circle() -> None:
    """Of both packages, also through functions and types."""
    graph = grimp.build_graph("gaga_core", "gaga_studio", cache_dir=None)
    modules = sorted(graph.modules)
    row_of = {module: row for row, module in enumerate(modules)}
    arrows = [
        (row_of[module], row_of[imported])
        for module in modules
        for imported in graph.find_modules_directly_imported_by(module)
    ]
    assert len(arrows) > len(modules)
    rows, columns = zip(*arrows, strict=True)
    matrix = coo_array(([1] * len(arrows), (rows, columns)), shape=(len(modules),) * 2)
    n, circle_of = connected_components(matrix, connection="strong")
    circles: list[list[str]] = [[] for _ in range(n)]
    for module, circle in zip(modules, circle_of, strict=True):
        circles[circle].append(module)
    assert [circle for circle in circles if len(circle) > 1] == []


def test_steps_of_placing_photos_start_without_what_few_of_them_need() -> None:
    """Each is a process of its own, whose start would be most of its time."""
    code = "import sys, gaga_core.placing.worker; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert {"scipy", "numba"}.isdisjoint(loaded.decode().split())


def test_no_test_imports_from_another_test_file() -> None:
    """What tests share is a fixture, or stands in a helper module."""
    tests = Path(__file__).parent
    found = [
        f"{path.relative_to(tests)} imports {module}"
        for path in sorted(tests.rglob("*.py"))
        for module in _imported(ast.parse(path.read_text(encoding="utf-8")))
        if module.rpartition(".")[2].startswith("test_")
    ]
    assert found == []


def _imported(tree: ast.Module) -> Iterator[str]:
    """Every module, and every name of a package, that a file imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module)
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_values_that_hold_arrays_are_compared_by_identity() -> None:
    """Two of them are otherwise compared element by element, which fails, or is slow."""
    failing = list[str]()
    root = Path(__file__).parent.parent
    for path in (*root.glob("app/**/*.py"), *root.glob("gaga_core/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ClassDef):
                continue
            how = [ast.unparse(one) for one in node.decorator_list]
            fields = [one for one in node.body if isinstance(one, ast.AnnAssign)]
            holds = any(
                "Array" in (held := ast.unparse(one.annotation))
                and "Callable" not in held
                and "compare=False" not in ast.unparse(one.value or ast.Constant(None))
                for one in fields
            )
            frozen = [one for one in how if one.startswith("dataclass(") and "frozen=True" in one]
            if holds and frozen and "eq=False" not in frozen[0]:
                failing.append(f"{path.name}: {node.name}")
    assert failing == []

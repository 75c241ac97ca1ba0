"""The maps in CONTRIBUTING.md are complete, and modules import only what stands above them."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE, CORE = ROOT / "src/masat", ROOT / "core"
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
# What may be imported from anywhere inside a function.
PRESENTATION = ("display.py", "plotting/")


def entries_of(folder):
    """The paths of a map, in its order; those of folders end in a slash."""
    block = re.search(rf"^    {folder}/\n((?:      .*\n)+)", CONTRIBUTING, re.MULTILINE).group(1)
    entries, inside = [], ""
    for line in block.splitlines():
        indent = len(line) - len(line.lstrip())
        # Names end where the description begins, two blanks or more behind them.
        names = re.split(r" {2,}", line.strip())[0].split(", ")
        if indent == 6:
            inside = names[0] if names[0].endswith("/") else ""
            entries += names
        else:
            assert inside, line
            entries += [inside + name for name in names]
    return entries


def position(path, entries):
    """Where a path stands: itself, or the closest folder that holds it.

    The `__init__.py` of a folder whose files are listed stands behind them.
    """
    if path in entries:
        return entries.index(path)
    folders = [entry for entry in entries if entry.endswith("/") and path.startswith(entry)]
    assert folders, f"{path} is not in the map of CONTRIBUTING.md"
    folder = max(folders, key=len)
    inside = [k for k, entry in enumerate(entries) if entry.startswith(folder) and entry != folder]
    if inside:
        assert path == f"{folder}__init__.py", f"{path} is not in the map of CONTRIBUTING.md"
        return inside[-1] + 0.5
    return entries.index(folder)


def path_of(module):
    """The file of a dotted name, relative to the package."""
    path = PACKAGE.parent.joinpath(*module.split("."))
    for file in (path.with_suffix(".py"), path.with_suffix(".pyi"), path / "__init__.py"):
        if file.is_file():
            return file.relative_to(PACKAGE).as_posix()
    return None


def imports_of(source):
    """The files of the package that a module imports, and whether inside a function."""
    found = []

    def visit(node, inside):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.ImportFrom):
                assert child.level == 0, "imports name their module in full"
                module = child.module or ""
                if module.split(".")[0] == "masat":
                    for alias in child.names:
                        file = path_of(f"{module}.{alias.name}") or path_of(module)
                        found.append((file, inside))
            elif isinstance(child, ast.Import):
                found.extend(
                    (path_of(alias.name), inside)
                    for alias in child.names
                    if alias.name.split(".")[0] == "masat"
                )
            within = inside or isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            visit(child, within)

    visit(ast.parse(source), False)
    return found


ENTRIES = entries_of("src/masat")
EXCEPTIONS = re.findall(r"^    (\S+\.py) -> (\S+\.py)$", CONTRIBUTING, re.MULTILINE)
MODULES = sorted(file.relative_to(PACKAGE).as_posix() for file in PACKAGE.rglob("*.py"))


def test_imports_are_found():
    source = (
        "from masat import lie\nfrom masat.formats import read\nimport masat.graph\nimport numpy\n"
        "if TYPE_CHECKING:\n    from masat import cli\n"
        "def f():\n    from masat.plotting import plot\n"
    )
    assert imports_of(source) == [
        ("lie.py", False),
        ("formats/__init__.py", False),
        ("graph.py", False),
        ("plotting/__init__.py", True),
    ]


@pytest.mark.parametrize("entry", ENTRIES)
def test_what_the_map_names_exists(entry):
    assert ENTRIES.count(entry) == 1
    assert (PACKAGE / entry).exists()


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_only_what_stands_above_it(module):
    here = position(module, ENTRIES)
    for imported, lazily in imports_of((PACKAGE / module).read_text()):
        if lazily and (imported.startswith(PRESENTATION) or (module, imported) in EXCEPTIONS):
            continue
        there = position(imported, ENTRIES)
        same_folder = Path(imported).parts[0] == Path(module).parts[0] and "/" in module
        assert there < here or (there == here and same_folder), f"{module} imports {imported}"


def test_each_exception_is_needed():
    for module, imported in EXCEPTIONS:
        assert (imported, True) in imports_of((PACKAGE / module).read_text())


FOLDERS = entries_of("core")
SOURCES = sorted(
    file.relative_to(CORE).as_posix()
    for file in CORE.rglob("*.[ch]pp")
    if "third_party" not in file.parts
)


@pytest.mark.parametrize("entry", FOLDERS)
def test_what_the_map_of_the_core_names_exists(entry):
    assert (CORE / entry).exists()


@pytest.mark.parametrize("source", SOURCES)
def test_a_file_of_the_core_includes_only_what_stands_above_it(source):
    here = position(source, FOLDERS)
    for included in re.findall(r'^#include "(.*)"', (CORE / source).read_text(), re.MULTILINE):
        if (CORE / included).exists():
            there = position(included, FOLDERS)
            assert there <= here, f"{source} includes {included}"

"""The pages and docstrings are true: their examples run, their links lead somewhere."""

import doctest
import importlib
import importlib.util
import pkgutil
import re
import shlex
import tomllib
from pathlib import Path

import click
import pytest

import masat
from masat.cli import _COMMANDS, cli
from masat.formats import FORMATS
from masat.initializers import INITIALIZERS
from masat.worlds import manhattan, perturb

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PAGES = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md"]
PAGES += sorted(page.relative_to(ROOT).as_posix() for page in ROOT.glob("docs/*.md"))
REPORTS = sorted(
    page.relative_to(ROOT).as_posix()
    for folder in ("reports", "study")
    for page in ROOT.glob(f"docs/{folder}/*.md")
)


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


def headings(page):
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def links(page):
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    return [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]


def runnable(page):
    """The Python blocks of a page, but for those of bridges whose package is not installed."""
    for block in blocks(page, "python"):
        bridge = re.search(r"^from masat\.bridges\.(\w+) import", block, re.MULTILINE)
        if bridge is None or importlib.util.find_spec(bridge[1]) is not None:
            yield block


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """A folder with a graph, as the pages expect it."""
    monkeypatch.chdir(tmp_path)
    masat.write(perturb(manhattan(300, 500, extent=10), (0.1, 0.1, 0.1)), "graph.g2o")
    return tmp_path


# Those of the first two pages run in the tests below.
@pytest.mark.parametrize("page", [page for page in PAGES[2:] if blocks(page, "python")])
def test_the_python_blocks_of_a_page_run_in_order(page, scratch, capsys):
    names = {"__name__": "page"}
    for block in runnable(page):
        exec(compile(block, page, "exec"), names)


def test_the_readme_makes_a_map_and_a_picture(scratch, capsys):
    names = {"__name__": "page"}
    for block in blocks("README.md", "python"):
        exec(compile(block, "README.md", "exec"), names)
    assert masat.read("map.g2o").chi2 < masat.read("graph.g2o").chi2
    assert Path("map.png").exists()
    assert "Result(levenberg_marquardt" in capsys.readouterr().out


def test_the_three_lines_of_the_readme_are_three():
    first = blocks("README.md", "python")[0].splitlines()
    calls = [line for line in first if line and not line.startswith("import")]
    assert [re.search(r"masat\.(\w+)", line)[1] for line in calls] == ["read", "solve", "write"]


def test_the_example_of_an_initial_guess_is_one():
    names = {"__name__": "page"}
    (block,) = blocks("CONTRIBUTING.md", "python")
    exec(compile(block, "CONTRIBUTING.md", "exec"), names)
    graph = manhattan(100, 150, extent=6)
    guess = names["first_spanning_tree"](graph)
    assert guess.chi2 < 1e-20
    assert (guess.poses == masat.initialize(graph, "spanning_tree").poses).all()


MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(masat.__path__, "masat.")
    if not module.name.endswith(("__main__", "._core"))
)


@pytest.mark.parametrize("name", ["masat", *MODULES])
def test_the_examples_of_docstrings_run(name, scratch):
    module = importlib.import_module(name)
    assert doctest.testmod(module, optionflags=doctest.ELLIPSIS).failed == 0


def test_some_docstrings_have_examples():
    finder = doctest.DocTestFinder()
    modules = [importlib.import_module(name) for name in MODULES]
    assert sum(len(test.examples) for m in modules for test in finder.find(m)) > 3


@pytest.mark.parametrize("page", [*PAGES, *REPORTS])
def test_links_lead_to_files_and_headings(page):
    for link in links(page):
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        if anchor:
            assert anchor in headings(target.resolve().relative_to(ROOT)), link


def test_each_page_is_in_the_index():
    index = set(links("docs/README.md"))
    assert index >= {page.name for page in ROOT.glob("docs/*.md")} - {"README.md"}
    assert index >= {f"reports/{page.name}" for page in ROOT.glob("docs/reports/*.md")}


def commands(page):
    """The command lines of the program in the blocks of a page, and in its code spans."""
    text = (ROOT / page).read_text()
    lines = re.findall(r"^ {4}(masat [a-z].*)$", text, re.MULTILINE)
    lines += [line for block in blocks(page, "sh") for line in block.splitlines()]
    spans = re.findall(r"`(masat [a-z][^`]*)`", text)
    for line in lines + spans:
        for part in line.split("&&"):
            words = shlex.split(part, comments=True)
            if words[:1] == ["masat"]:
                yield words[1:]


@pytest.mark.parametrize("page", [*PAGES, *REPORTS])
def test_the_commands_of_a_page_have_the_options_that_it_names(page):
    for words in commands(page):
        command, rest = cli, list(words)
        while isinstance(command, click.Group) and rest and not rest[0].startswith("-"):
            found = command.get_command(click.Context(command), rest.pop(0))
            assert found is not None, words
            command = found
        known = {name for parameter in command.params for name in parameter.opts}
        known |= {name for parameter in command.params for name in parameter.secondary_opts}
        options = {word for word in rest if re.fullmatch(r"--?[a-z][a-z-]*", word)}
        assert options <= known | {"--help", "-h", "--version"}, words


@pytest.mark.parametrize("name", ["g2o", "toro", "isam"])
@pytest.mark.parametrize("page", ["README.md", "docs/formats.md"])
def test_the_pages_name_every_tag(page, name):
    for record in FORMATS[name].records:
        assert f"`{record.tag}`" in (ROOT / page).read_text()


@pytest.mark.parametrize("name", FORMATS)
def test_the_page_of_formats_names_every_format(name):
    assert f"`{name}`" in (ROOT / "docs/formats.md").read_text()


def test_the_readme_names_every_command():
    for command in _COMMANDS:
        assert f"`masat {command}" in README


def test_the_readme_names_the_two_commands():
    assert "make demo" in README
    assert "make test" in README


@pytest.mark.parametrize("name", INITIALIZERS)
def test_each_initial_guess_is_described_and_has_a_reason_to_stay(name):
    text = (ROOT / "docs/initial_guesses.md").read_text()
    assert len(re.findall(rf"^\| `{name}` \|", text, re.MULTILINE)) >= 2


def test_the_changelog_knows_the_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()

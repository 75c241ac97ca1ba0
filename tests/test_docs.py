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
from click.testing import CliRunner

import masat
from masat.cli import _COMMANDS, cli
from masat.formats import FORMATS
from masat.initializers import INITIALIZERS
from masat.worlds import manhattan, perturb

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
PAGES = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md"]
ALL = sorted(page.relative_to(ROOT).as_posix() for page in ROOT.glob("docs/**/*.md"))
REPORTS = [
    page for page in ALL if page.startswith(("docs/reports/", "docs/study/", "docs/spatial/"))
]
PAGES += [page for page in ALL if page not in REPORTS]


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


def examples(page):
    """The blocks of a page in Python and for the shell, with their language, in order.

    Those of bridges whose package is not installed are left out.
    """
    every = re.findall(r"```(python|sh)\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    bridges = [re.search(r"^from masat\.bridges\.(\w+) import", b, re.MULTILINE) for _, b in every]
    return [
        example
        for example, bridge in zip(every, bridges, strict=True)
        if bridge is None or importlib.util.find_spec(bridge[1]) is not None
    ]


def run_shell(block):
    """Run the commands of a block, each of which has to succeed."""
    for line in block.splitlines():
        program, *words = shlex.split(line, comments=True)
        assert program == "masat", line
        outcome = CliRunner().invoke(cli, words)
        assert outcome.exit_code == 0, (line, outcome.output, outcome.exception)


def headings(page):
    """The anchors of a page's headings, as GitHub makes them."""
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def links(page):
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text(), flags=re.DOTALL)
    return [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """A folder with a graph, as the pages expect it."""
    monkeypatch.chdir(tmp_path)
    masat.write(perturb(manhattan(300, 500, extent=10), (0.1, 0.1, 0.1)), "graph.g2o")
    return tmp_path


# Those of these pages run in the tests below, or in those of studies.
ELSEWHERE = ("README.md", "docs/extending.md", "docs/studies.md")


@pytest.mark.parametrize("page", [p for p in PAGES if examples(p) and p not in ELSEWHERE])
def test_the_examples_of_a_page_run_in_order(page, scratch, capsys):
    names = {"__name__": "page"}
    for language, block in examples(page):
        if language == "sh":
            run_shell(block)
        else:
            exec(compile(block, page, "exec"), names)


def test_the_python_of_the_page_of_studies_runs(scratch, capsys):
    for block in blocks("docs/studies.md", "python"):
        exec(compile(block, "docs/studies.md", "exec"), {"__name__": "page"})


def test_the_tutorial_makes_a_map_and_a_picture(scratch, capsys):
    page, names = "docs/tutorial/trusted_map.md", {"__name__": "page"}
    for block in blocks(page, "sh"):
        run_shell(block)
    assert Path("map.html").exists()
    for block in blocks(page, "python"):
        exec(compile(block, page, "exec"), names)
    assert masat.read("map.g2o").chi2 > 0
    assert Path("map.png").exists()
    assert "Result(levenberg_marquardt" in capsys.readouterr().out


def test_the_three_lines_of_the_readme_make_a_map(scratch):
    (block,) = blocks("README.md", "python")
    calls = [line for line in block.splitlines() if line and not line.startswith("import")]
    assert [re.search(r"masat\.(\w+)", line)[1] for line in calls] == ["read", "solve", "write"]
    exec(compile(block, "README.md", "exec"), {"__name__": "page"})
    assert masat.read("map.g2o").chi2 < masat.read("graph.g2o").chi2


def test_the_three_commands_of_the_readme_make_a_page(scratch):
    install, *others = re.findall(r"^ {4}(.*)$", README, re.MULTILINE)
    assert install == "pip install masat"
    run_shell("\n".join(others))
    assert len(others) == 2
    assert Path("map.html").exists()


def test_the_example_of_an_initial_guess_is_one():
    names = {"__name__": "page"}
    (block,) = blocks("docs/extending.md", "python")
    exec(compile(block, "docs/extending.md", "exec"), names)
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
    index = {link.partition("#")[0] for link in links("docs/README.md")}
    pages = {page.removeprefix("docs/") for page in ALL}
    assert index >= pages - {
        "README.md",
        "study/report.md",
        "starts/report.md",
        "spatial/report.md",
    }


def site_hooks():
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "tools/site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_page_is_once_in_the_navigation_of_the_site():
    nav = re.search(r"^nav:\n((?: .*\n)+)", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)[1]
    found = re.findall(r"[\w/]+\.md", nav)
    outside = site_hooks().OUTSIDE
    assert all((ROOT / page).exists() for page in outside)
    assert sorted(found) == sorted([*outside.values(), *(p.removeprefix("docs/") for p in ALL)])


def test_the_site_has_every_option_of_every_command():
    page = (ROOT / "docs/command_line.md").read_text()
    hooks = site_hooks()
    assert hooks.REFERENCE in page
    reference = hooks.command_reference()
    for name in _COMMANDS:
        assert f"## masat {name}\n" in reference
        command = cli.get_command(click.Context(cli), name)
        for option in (o for p in command.params for o in p.opts if o.startswith("--")):
            assert option in reference, (name, option)
    assert "## masat study run\n" in reference


def test_the_pages_of_the_api_have_every_public_name_once():
    names = []
    for page in ALL:
        if page.startswith("docs/api/"):
            names += re.findall(r"^::: (\S+)$", (ROOT / page).read_text(), re.MULTILINE)
    assert len(set(names)) == len(names)
    assert set(names) >= {f"masat.{name}" for name in set(masat.__all__) - {"__version__"}}
    for name in names:
        assert pkgutil.resolve_name(name).__doc__, name


def test_each_picture_is_on_a_page_and_has_a_function_that_draws_it():
    made = re.findall(r"^def (\w+)\(\):$", (ROOT / "docs/pictures/make.py").read_text(), re.M)
    shown = {Path(link).name for page in ALL for link in links(page)}
    files = [path for path in (ROOT / "docs/pictures").iterdir() if path.suffix in (".png", ".svg")]
    assert sorted(path.stem for path in files) == sorted(made)
    assert {path.name for path in files} <= shown


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
def test_the_page_of_formats_names_every_tag(name):
    for record in FORMATS[name].records:
        assert f"`{record.tag}`" in (ROOT / "docs/formats.md").read_text()


@pytest.mark.parametrize("name", FORMATS)
def test_the_page_of_formats_names_every_format(name):
    assert f"`{name}`" in (ROOT / "docs/formats.md").read_text()


def test_the_page_of_the_command_line_names_every_command():
    text = (ROOT / "docs/command_line.md").read_text()
    for command in _COMMANDS:
        assert f"`masat {command}" in text


def test_the_readme_is_a_screen_that_names_the_commands():
    assert len(README.splitlines()) <= 60
    for command in ("pip install masat", "pip install .", "make demo", "make test", "make docs"):
        assert command in README


@pytest.mark.parametrize("name", INITIALIZERS)
def test_each_initial_guess_is_described_and_has_a_reason_to_stay(name):
    text = (ROOT / "docs/initial_guesses.md").read_text()
    assert len(re.findall(rf"^\| `{name}` \|", text, re.MULTILINE)) >= 2


def test_the_changelog_knows_the_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()


def test_the_citation_and_the_recipe_have_the_version_and_the_requirements():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = (ROOT / "conda/recipe.yaml").read_text()
    assert f"\nversion: {project['version']}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'version: "{project["version"]}"' in recipe
    for requirement in project["dependencies"]:
        name, least = re.match(r"(\w+)>=([\d.]+)", requirement).groups()
        assert re.search(rf"- {name}(-base)? >={re.escape(least)}\n", recipe), requirement

"""Hooks of the documentation site: pages from outside docs/, and the command reference.

mkdocs calls them (`hooks` in mkdocs.yml). `make docs` builds the site.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).parents[1]
# Pages of the repository that are not in docs/, and their names on the site.
OUTSIDE = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
}
REFERENCE = "<!-- The site has all options here, generated from the commands by tools/site.py. -->"


def on_files(files: Any, config: Any) -> Any:
    """Add the pages from outside docs/."""
    from mkdocs.structure.files import File

    for path, name in OUTSIDE.items():
        files.append(File.generated(config, name, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Lead links to the pages of the site; add the reference to the page of commands."""
    name = page.file.src_uri
    inside = {site: path for path, site in OUTSIDE.items()}
    path = inside.get(name, f"docs/{name}")

    def target(match: re.Match[str]) -> str:
        link, anchor = match[1], match[2] or ""
        found = os.path.normpath(os.path.join(os.path.dirname(path), link))  # noqa: PTH118, PTH120
        site = OUTSIDE.get(found, found.removeprefix("docs/"))
        return f"]({os.path.relpath(site, os.path.dirname(name) or '.')}{anchor})"  # noqa: PTH120

    markdown = re.sub(r"\]\(([^)\s#:]+)(#[^)\s]*)?\)", target, markdown)
    if REFERENCE in markdown:
        markdown = markdown.replace(REFERENCE, command_reference())
    return markdown


def on_post_build(config: Any) -> None:
    """Refuse a site that fetches anything from elsewhere when it is read."""
    loads = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=[\"']?(https?:)?//")
    for page in Path(config.site_dir).rglob("*.html"):
        if found := loads.search(page.read_text()):
            raise SystemExit(f"{page}: loads from elsewhere: {found[0]}")


def command_reference() -> str:
    """Return the usage, the help and the options of every command, as Markdown."""
    from masat.cli import cli

    context = click.Context(cli, info_name="masat", max_content_width=100)
    return "\n\n".join(_section(cli, context, level=2))


def _section(command: click.Command, context: click.Context, level: int) -> list[str]:
    """Return the paragraphs of a command and of its subcommands."""
    usage = " ".join(command.collect_usage_pieces(context))
    parts = [
        f"{'#' * level} {context.command_path}",
        f"    {context.command_path} {usage}",
        _prose(command.help or ""),
        _options(command, context),
        _prose(command.epilog or ""),
    ]
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            child = command.get_command(context, name)
            assert child is not None
            inner = click.Context(child, info_name=name, parent=context)
            parts += _section(child, inner, level + (context.parent is not None))
    return [part for part in parts if part]


def _prose(text: str) -> str:
    """Return the paragraphs of a help text; those that click keeps as they are become code."""
    parts = []
    for part in re.split(r"\n\s*\n", text.strip()):
        if part.lstrip().startswith("\b"):
            lines = part.replace("\b", "").strip("\n").splitlines()
            parts.append("\n".join(f"    {line.strip()}" for line in lines if line.strip()))
        else:
            parts.append(_plain(part))
    return "\n\n".join(parts)


def _entity(match: re.Match[str]) -> str:
    return f"&#{ord(match[0])};"


def _plain(text: str) -> str:
    """Return text in one line, with nothing but its backticks as Markdown."""
    parts = " ".join(text.split()).split("`")
    for k in range(0, len(parts), 2):  # outside of backticks
        parts[k] = re.sub(r"[][|*_<>&]", _entity, parts[k])
    return "`".join(parts)


def _options(command: click.Command, context: click.Context) -> str:
    """Return the table of a command's options."""
    rows = []
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None:
            option, text = (_plain(part) for part in record)
            rows.append(f"| <code>{option}</code> | {text} |")
    return "\n".join(["| option | what it does |", "|---|---|", *rows]) if rows else ""

"""Cells of tutorials as a reader types them: `%%sh` becomes a terminal, `%%writefile NAME` a file with its name above."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

LANGUAGES = {".yaml": "yaml", ".py": "python", ".csv": "text", ".toml": "toml"}


def setup(app: Sphinx) -> dict[str, Any]:
    """Change the cells after a tutorial was executed and before its page is written."""
    app.connect("doctree-read", _as_typed)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _as_typed(_: Sphinx, doctree: nodes.document) -> None:
    for block in list(doctree.findall(nodes.literal_block)):
        magic, _, rest = block.astext().partition("\n")
        if magic.split()[:1] == ["%%sh"]:  # options only choose lines of the output
            _replace(block, "console", _with_prompts(rest))
        elif magic.startswith("%%writefile "):
            name = magic.split()[1]
            _replace(block, LANGUAGES.get(name[name.rfind(".") :], "text"), rest)
            block.parent.insert(block.parent.index(block), nodes.paragraph(name, name, classes=["file-name"]))


def _replace(block: nodes.literal_block, language: str, text: str) -> None:
    block.rawsource, block["language"] = text, language
    block.children = [nodes.Text(text)]


def _with_prompts(text: str) -> str:
    """`$` before every command; lines that go on from the one before are moved in."""
    lines = text.splitlines()
    goes_on = [False, *[line.endswith("\\") for line in lines[:-1]]]
    return "\n".join(("  " if after else "$ ") + line for line, after in zip(lines, goes_on, strict=True))

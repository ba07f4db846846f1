"""Sentence lengths of the documentation by page, and phrases that a physicist would not say; `make words` prints both."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
LONGEST = 45  # words of a sentence
LARGEST_MEAN = {"README.md": 17.0, "docs/results.md": 18.0, "docs/explanation": 18.0}
"""Words a sentence in the mean of a page, or over all pages of a folder."""

BANNED = {
    r"leaves? the house": "export",
    r"outlives?": "continues after",
    r"every now and then": "periodically",
    r"\bpile[sd]?\b|\bpiling\b": "many causes; accumulate",
    r"\belsewhere\b": "at another place; in other programs",
    r"\bstanding\b": "fixed; current",
    r"\bspares?\b|\bspared\b": "free; avoid",
    r"\bnews\b": "new readings; new events",
    r"\b(?:finds?|leaves?|makes?|has|have) room\b": "a free slot",
    r"\bno fresh look\b": "these seeds were seen before",
    r"\bWanted (?:is|are|was|were)\b|\bwhere \w+ (?:is|are|was|were) wanted\b": "target",
    r"\b[Ww]ho (?:wants|reads|sees|sends|knows|needs|installed|has)\b|\bWhoever\b|\bwhoever\b": "to do this, ...",
    r"\bis no exam\b": "is not independent",
    r"\blet alone\b": "undisturbed",
    r"\b(?:falls?|fell) over\b": "fails",
    r"\bis none\b|\bare none\b": "there is no",
    r"\bas it were\b|\bso to speak\b": "",
    r"\bits own way\b|\bmind of its own\b": "",
    r"\b(?:reads?|goes|go|going) along\b": "follows",
    r"\bfools?\b|\bfooled\b|\bguess(?:es)? the\b": "mislead",
    r"\bwhat is otherwise\b": "active during an interval",
    r"\bin the way of\b": "prevents",
    r"\bso much the\b|\ball the same\b": "still",
    r"\bcomes? (?:out|in) to the\b|\bcomes? to hand\b|\bat hand\b": "available",
    r"\bhand(?:s|ed)? out\b": "export; return",
}
"""Phrases that are rewritten, by what is said in their place. A page keeps its file name."""

FENCE = re.compile(r"^( *)(```+|:::+).*?^\1\2 *$", re.DOTALL | re.MULTILINE)
COMMENT = re.compile(r"<!--.*?-->|^---\n.*?^---\n", re.DOTALL | re.MULTILINE)
FORMULA = re.compile(r"\$\$.*?\$\$|\$[^$\n]+\$", re.DOTALL)
CODE = re.compile(r"`[^`\n]+`")
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
ENDS_NOTHING = re.compile(r"\b(et al|e\.g|i\.e|vs|Fig|Figs|eq|No|Dr|St)\.")
END = re.compile(r"(?<=[.!?])[\"')\]*_]*\s+(?=[\"'(\[*_]*[A-Z0-9µ])|(?<=[.!?])[*_]+\s+")
ITEM = re.compile(r"^\s*(?:[-*+]|\d+\.)\s+", re.MULTILINE)


class Sentence(NamedTuple):
    """One sentence or table cell, with the line on which its block begins."""

    line: int
    text: str
    is_prose: bool

    @property
    def n_words(self) -> int:
        """Words, of which each has a letter or a digit."""
        return len([word for word in self.text.split() if re.search(r"\w", word)])


def pages() -> list[Path]:
    """README, and the pages of docs that somebody wrote."""
    return [
        ROOT / "README.md",
        *sorted(page for page in (ROOT / "docs").rglob("*.md") if "causes" not in page.parts),
    ]


def sentences(text: str) -> Iterator[Sentence]:
    """Sentences of a page: code is one word, a link its text; headings are left out."""
    for pattern in (FENCE, COMMENT):
        text = pattern.sub(lambda match: "\n" * match[0].count("\n"), text)
    text = CODE.sub("Code", FORMULA.sub("formula", text))
    text = LINK.sub(lambda match: " ".join(match[1].split()), text)
    text = ENDS_NOTHING.sub(lambda match: match[1], text)
    for line, block in blocks(text):
        is_table = block.startswith("|")
        parts = block.split("|") if is_table else ITEM.split(block)
        for part in parts:
            for sentence in END.split(" ".join(part.split())):
                if re.search(r"\w", sentence):
                    yield Sentence(line, sentence.strip(), not is_table)


def blocks(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs, list items and rows of tables, by their first line."""
    start, lines = 0, []
    for number, line in enumerate([*text.splitlines(), ""], start=1):
        begins = line.startswith("|") or ITEM.match(line) is not None
        if (not line.strip() or begins or line.startswith("#")) and lines:
            yield start, "\n".join(lines)
            lines = []
        if line.strip() and not line.startswith("#"):
            start = start if lines else number
            lines.append(line)


def banned(text: str) -> Iterator[tuple[int, str, str]]:
    """Line, phrase and what to say in its place; code and addresses of links are not read."""
    text = FENCE.sub(lambda match: "\n" * match[0].count("\n"), text)
    text = re.sub(r"\]\([^)]*\)", "]", CODE.sub("", text))
    for number, line in enumerate(text.splitlines(), start=1):
        for pattern, instead in BANNED.items():
            for match in re.finditer(pattern, line):
                yield number, match[0], instead


def shown(page: Path) -> str:
    """A page by its path in the repository."""
    return str(page.resolve().relative_to(ROOT)) if page.resolve().is_relative_to(ROOT) else str(page)


def mean_words(texts: list[str]) -> float:
    """Words a sentence over the prose of several pages."""
    lengths = [s.n_words for text in texts for s in sentences(text) if s.is_prose]
    return sum(lengths) / len(lengths) if lengths else 0.0


def too_long(text: str) -> list[Sentence]:
    """Sentences beyond the limit."""
    return [sentence for sentence in sentences(text) if sentence.n_words > LONGEST]


def main() -> None:
    """Print a table of pages, then long sentences and banned phrases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", type=Path, nargs="*", help="pages; without them all")
    named = parser.parse_args().pages or pages()
    print(f"{'words':>6} {'a sentence':>10} {'longest':>7}  page")
    for page in named:
        text = page.read_text(encoding="utf-8")
        longest = max((sentence.n_words for sentence in sentences(text)), default=0)
        print(f"{len(text.split()):6d} {mean_words([text]):10.1f} {longest:7d}  {shown(page)}")
    for page in named:
        text = page.read_text(encoding="utf-8")
        for sentence in too_long(text):
            print(f"{shown(page)}:{sentence.line}: {sentence.n_words} words: {sentence.text[:90]}")
        for line, phrase, instead in banned(text):
            print(f"{shown(page)}:{line}: '{phrase}'" + (f"; say: {instead}" if instead else ""))


if __name__ == "__main__":
    main()

"""Prints how much code each package has: lines without blanks, comments and docstrings, those of constants too: `make size`."""

from __future__ import annotations

import argparse
import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

WITHOUT_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def lines_of_code(source: str) -> int:
    r"""Lines of a module that hold code.

    Examples:
        >>> lines_of_code("'A module.'\n\nmost = 3  # of them\n'What it means.'\n")
        1
    """
    words = {
        line
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    code = {
        line
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type not in WITHOUT_CODE
        for line in range(token.start[0], token.end[0] + 1)
    }
    return len(code - words)


def main() -> None:
    """Print a line for each folder and for each package just below it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    for folder in parser.parse_args().folders:
        sizes: Counter[str] = Counter()
        for path in folder.rglob("*.py"):
            package = path.relative_to(folder).parts[0]
            sizes[package] += lines_of_code(path.read_text(encoding="utf-8"))
        print(f"{sizes.total():7,} {folder}")
        for package, size in sizes.most_common():
            print(f"{size:7,}   {package}")


if __name__ == "__main__":
    main()

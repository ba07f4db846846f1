"""Whether a built site loads everything that it shows from itself: no script, style, font or picture of another computer."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video)\b[^>]*\bsrc=["'](?P<src>(?:https?:)?//[^"']+)"""
    r"""|<link\b(?=[^>]*rel=["'](?:stylesheet|preload|icon|preconnect))[^>]*href=["'](?P<href>(?:https?:)?//[^"']+)""",
    re.IGNORECASE,
)
IN_STYLES = re.compile(r"""(?:url\(|@import\s+)["']?(?P<url>(?:https?:)?//[^"')]+)""")


def loaded_from_elsewhere(site: Path) -> list[str]:
    """Page and address of everything that a browser would fetch from another computer."""
    found = []
    for file in sorted(site.rglob("*")):
        pattern = {".html": LOADED, ".css": IN_STYLES}.get(file.suffix)
        if pattern is not None:
            text = file.read_text(encoding="utf-8")
            found += [
                f"{file.relative_to(site)}: {match[match.lastgroup or 0]}" for match in pattern.finditer(text)
            ]
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("site", type=Path)
    elsewhere = loaded_from_elsewhere(parser.parse_args().site)
    print("\n".join(elsewhere) or "the site loads nothing from elsewhere")
    sys.exit(bool(elsewhere))

"""Which encoding a text has: by its byte order mark, by its zeros, else UTF-8 where it is that, else the likeliest by its letters."""

from __future__ import annotations

import codecs
from itertools import pairwise
from pathlib import Path

from estimator.given_files import MOST_TABLE_BYTES, open_given

SAMPLE_BYTES = 1_000_000
SHARE_OF_ZEROS = 0.3  # of the bytes of a text in UTF-16 in which most letters are Latin
MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# What programs of laboratories write; others are so like these that letters do not tell them apart.
EASTERN = ["shift_jis", "gb18030"]
LIKELY = ["cp1252", "latin_1", "cp1250", "cp1251", "mac_roman", *EASTERN]


def encoding_of(path: Path) -> str:
    """The encoding of a file, as Python names it.

    Args:
        path: A regular file; its first part decides between other encodings, all of it whether it is UTF-8.
    Raises:
        InvalidInput: It cannot be read.
    """
    decoder = codecs.getincrementaldecoder("utf-8")()
    with open_given(path, MOST_TABLE_BYTES, rule="must be readable as text") as file:
        sample = file.read(SAMPLE_BYTES)
        for mark, name in MARKS:
            if sample.startswith(mark):
                return name
        even, odd = sample[::2].count(0), sample[1::2].count(0)
        if even + odd > SHARE_OF_ZEROS * len(sample) and min(even, odd) < 0.1 * max(even, odd):
            return "utf-16-le" if odd > even else "utf-16-be"
        try:
            block = sample
            while block:
                decoder.decode(block)
                block = file.read(SAMPLE_BYTES)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return _likely(sample)
    return "utf-8"


def _likely(sample: bytes) -> str:
    from charset_normalizer import from_bytes

    told = b"\n".join(line for line in sample.splitlines() if any(byte > 127 for byte in line))
    best = from_bytes(told or sample, cp_isolation=LIKELY).best()
    name = "cp1252" if best is None else best.encoding
    # Where Latin letters alone decide, a micro sign, a degree or a single umlaut is what is meant.
    is_western = any(mark in told for mark in (b"\xb5", b"\xb0")) or name in EASTERN
    return "cp1252" if is_western and not _is_cjk(told, name) else name


def _is_cjk(told: bytes, name: str) -> bool:
    """Whether a text in an encoding holds letters of China, Japan or Korea, more than one in a row."""
    letters = [letter >= "\u2e80" for letter in told.decode(name, errors="replace")]
    return any(first and second for first, second in pairwise(letters))

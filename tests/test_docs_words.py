"""Words in the documentation: short sentences, no phrase that a physicist would not say (`make words` prints them)."""

from __future__ import annotations

import re

import pytest

from scripts.documentation import words

MOST_DECISIONS, LONGEST_DECISION = 30, 250


def test_no_sentence_is_too_long():
    found = [
        f"{words.shown(page)}:{s.line}: {s.n_words} words: {s.text}"
        for page in words.pages()
        for s in words.too_long(page.read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(found)


def test_no_phrase_is_banned():
    found = [
        f"{words.shown(page)}:{line}: {phrase}"
        for page in words.pages()
        for line, phrase, _ in words.banned(page.read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(("place", "largest"), words.LARGEST_MEAN.items())
def test_sentences_are_short_on_average(place, largest):
    path = words.ROOT / place
    chosen = [path] if path.is_file() else sorted(path.glob("*.md"))
    assert words.mean_words([page.read_text(encoding="utf-8") for page in chosen]) <= largest


def test_decisions_are_few_and_short():
    notes = sorted((words.ROOT / "docs/decisions").glob("*.md"))
    assert len(notes) <= MOST_DECISIONS
    for note in notes:
        text = note.read_text(encoding="utf-8")
        assert len(text.split()) <= LONGEST_DECISION, note
        assert re.search(r"^Status: \w+", text, re.MULTILINE), note


def test_sentences_of_a_page_are_counted():
    text = "# A title\n\nOne two `code` three. [Four](x.md)\nfive six:\n\n- seven eight.\n- nine\n\n| a | b c |\n|---|---|\n```sh\nnot this\n```\n"
    lengths = [(s.n_words, s.is_prose) for s in words.sentences(text)]
    assert lengths == [(4, True), (3, True), (2, True), (1, True), (1, False), (2, False)]
    assert words.too_long("word " * 46 + ".")
    assert [s.line for s in words.sentences("a.\n\nb.\n")] == [1, 3]


@pytest.mark.parametrize(
    "sentence",
    [
        "Calibrations leave the house.",
        "It calls something every now and then, and outlives its faults.",
        "That is no fresh look.",
        "Wanted were 40: 218.",
        "Who wants another limit compares.",
        "A reading beside it is no exam.",
        "A pile of causes stands elsewhere.",
    ],
)
def test_banned_phrases_are_seen(sentence):
    assert list(words.banned(sentence))
    assert not list(words.banned(f"`{sentence}`")), "code is not read"

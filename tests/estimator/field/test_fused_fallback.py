"""Without a C compiler that works, a graphics processor computes fields all the same."""

from __future__ import annotations

import torch

from estimator.field import fused


def test_a_kernel_that_cannot_be_translated_is_not_used_and_one_sentence_says_why(monkeypatch, caplog):
    def without_linker() -> None:
        raise RuntimeError("gcc returned 1: cannot find 'ld'")

    fused._is_translated.cache_clear()
    monkeypatch.setattr(fused, "_kernel", without_linker)
    assert not fused._is_translated(torch.device("cpu"))
    assert not fused._is_translated(torch.device("cpu"))
    assert [record.getMessage() for record in caplog.records] == [
        "fields are computed by operations of torch, which takes ten times as long: Triton cannot translate its kernel "
        "(gcc returned 1: cannot find 'ld')"
    ]
    fused._is_translated.cache_clear()

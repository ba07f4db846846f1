"""A checkout says its commit; elsewhere nothing is known."""

from __future__ import annotations

import subprocess

from estimator import code_version as module
from estimator.code_version import code_version


def test_a_checkout_says_its_commit_and_whether_files_differ_from_it(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ROOT", tmp_path)
    code_version.cache_clear()
    assert code_version() is None

    def git(*words: str) -> str:
        identity = ["-c", "user.name=me", "-c", "user.email=me@example.org"]
        return subprocess.run(
            ["git", "-C", tmp_path, *identity, *words], check=True, capture_output=True, text=True
        ).stdout

    git("init")
    (tmp_path / "code.py").write_text("")
    git("add", ".")
    git("commit", "-m", "first")
    commit = git("rev-parse", "HEAD").strip()
    code_version.cache_clear()
    assert code_version() == commit
    (tmp_path / "code.py").write_text("changed")
    code_version.cache_clear()
    assert code_version() == f"{commit}-dirty"
    code_version.cache_clear()

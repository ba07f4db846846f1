"""Programs that a test starts end with it, also where it fails before it has waited for them."""

from __future__ import annotations

import pytest

from tests.program import PYTHON, launched, programs_end


def test_what_a_failed_test_leaves_running_ends_and_its_pipes_are_closed():
    with pytest.raises(ZeroDivisionError), programs_end():  # noqa: PT012
        running = launched(PYTHON, "-c", "import time; time.sleep(60)")
        raise ZeroDivisionError
    assert running.returncode is not None
    assert running.stdout is not None
    assert running.stdout.closed

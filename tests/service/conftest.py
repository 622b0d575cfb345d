"""What several tests of the service begin with."""

from __future__ import annotations

import pytest

from daemon_kit import Running


@pytest.fixture
def running(tmp_path):
    """Makes daemons in processes of their own, and ends them."""
    made = []

    def make(*arguments, **options) -> Running:
        made.append(Running(tmp_path, *arguments, **options))
        return made[-1]

    yield make
    for one in made:
        one.end()

"""The limit of memory holds, and only while it should."""

from __future__ import annotations

import resource

import numpy as np
import pytest

from lodpipe.service.memory import memory_limit, peak_memory_mb


def test_beyond_the_limit_allocation_fails_and_afterwards_it_does_not():
    before = resource.getrlimit(resource.RLIMIT_DATA)
    with memory_limit(0.5):
        assert np.ones(100 << 20, np.uint8).all()
        with pytest.raises(MemoryError):
            np.ones(600 << 20, np.uint8)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    assert len(np.empty(600 << 20, np.uint8)) == 600 << 20


def test_peak_memory_is_in_megabytes():
    assert 20 < peak_memory_mb() < 100_000

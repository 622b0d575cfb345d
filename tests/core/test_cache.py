"""What is kept, and what is dropped."""

from __future__ import annotations

from lodpipe.core.cache import Cache


def test_a_value_is_made_once():
    cache, made = Cache(), []
    assert [cache.get("a", lambda: made.append(1) or 7, lambda value: 10) for _ in range(3)] == [7, 7, 7]
    assert len(made) == 1


def test_the_least_recently_used_goes_first():
    cache = Cache(limit=100)
    for key in "abc":
        cache.get(key, lambda: 1, lambda value: 40)
        cache.get("a", lambda: 1, lambda value: 40)
    again = []
    for key in "acb":
        cache.get(key, lambda key=key: again.append(key), lambda value: 40)
    assert again == ["b"]
    assert cache.held <= 100


def test_what_is_too_large_is_not_kept():
    cache = Cache(limit=100)
    cache.get("small", lambda: 1, lambda value: 60)
    assert cache.get("large", lambda: 2, lambda value: 101) == 2
    assert (len(cache), cache.held) == (1, 60)

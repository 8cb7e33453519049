"""Garbage collection is less frequent during a run and restored afterwards."""

import gc
from collections.abc import Iterator

import pytest

from metro_hil.model.gc_tuning import COLLECT_AFTER, rarely_collected


@pytest.fixture(autouse=True)
def _put_back() -> Iterator[None]:
    usual = gc.get_threshold()
    yield
    gc.set_threshold(*usual)


def test_the_former_settings_return_after_the_block_and_after_an_error() -> None:
    gc.set_threshold(700, 11, 12)
    with rarely_collected():
        assert gc.get_threshold() == (COLLECT_AFTER, 11, 12)
    assert gc.get_threshold() == (700, 11, 12)
    with pytest.raises(KeyError), rarely_collected():
        raise KeyError
    assert gc.get_threshold() == (700, 11, 12)


@pytest.mark.parametrize("first", [0, COLLECT_AFTER + 1])
def test_a_caller_with_collection_off_or_rarer_keeps_its_settings(first: int) -> None:
    gc.set_threshold(first, 11, 12)
    with rarely_collected():
        assert gc.get_threshold() == (first, 11, 12)

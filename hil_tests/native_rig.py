"""Runs the tests of a module twice: with the readable Python code, and with the same in C."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import pytest

from can_dbc import codec
from firmware_py.native.core import native_core, use_core
from metro_hil.model.native import codec_module, core_module, use_native


@cache
def built() -> tuple[Any, Any]:
    """The codec, and bus and logs, in C. Raises BuildError."""
    return codec_module(), core_module()


@contextmanager
def code_in(language: str) -> Iterator[None]:
    """Use the code in this language for all that is created within the block."""
    use_native()
    before = codec.compiled_codec(), native_core()
    wire, core = built() if language == "C" else (None, None)
    codec.use_compiled(wire)
    use_core(core)
    try:
        yield
    finally:
        codec.use_compiled(before[0])
        use_core(before[1])


@pytest.fixture(scope="module", autouse=True, params=["Python", "C"])
def in_both_languages(request: pytest.FixtureRequest) -> Iterator[None]:
    """Import this into a module to run its tests twice; the second time if there is a compiler."""
    if request.param == "C":
        request.getfixturevalue("c_compiler")
    with code_in(request.param):
        yield

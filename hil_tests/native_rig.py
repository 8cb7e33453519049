"""Runs the tests of a module twice: with the readable Python code, and with the same in C."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import pytest

from can_dbc import codec
from firmware_py.native.build import BuildError
from firmware_py.native.core import native_core, use_core
from metro_hil.model.native import codec_module, core_module, use_native


@cache
def built() -> tuple[Any, Any]:
    """The codec, and bus and logs, in C. Without a compiler a test is skipped, in CI it fails."""
    try:
        return codec_module(), core_module()
    except BuildError as error:
        if os.environ.get("CI"):
            pytest.fail(str(error), pytrace=False)
        pytest.skip(str(error))


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
    """Import this into a module to run its tests twice."""
    with code_in(request.param):
        yield

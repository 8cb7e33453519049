"""Kernel modules with all that they depend on, in the order to load. Pure."""

import re
from collections.abc import Callable, Iterable
from typing import Final

DEPENDS: Final = re.compile(rb"\0depends=([^\0]*)\0")
"""In the section .modinfo of a module: the names of others, with commas."""


def module_name(file_name: str) -> str:
    """As the kernel calls it: without .ko and what follows, and with underscores."""
    return file_name.partition(".ko")[0].replace("-", "_")


def dependencies(module: bytes) -> list[str]:
    """The modules that have to be loaded before this one."""
    found = DEPENDS.search(module)
    return found[1].decode().replace("-", "_").split(",") if found and found[1] else []


def in_load_order(
    wanted: Iterable[str], content: Callable[[str], bytes | None]
) -> dict[str, bytes]:
    """Modules by name, each behind those that it depends on.

    Args:
        wanted: names, spelt either way.
        content: of a module by name; None if it is no file, as the kernel has it built in.
    """
    loaded: dict[str, bytes] = {}

    def add(name: str) -> None:
        module = None if name in loaded else content(name)
        if module is None:
            return
        for needed in dependencies(module):
            add(needed)
        loaded[name] = module

    for name in wanted:
        add(module_name(name))
    return loaded

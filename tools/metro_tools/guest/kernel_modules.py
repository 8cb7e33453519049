"""Kernel modules with their dependencies, in load order. Pure."""

import re
from collections.abc import Callable, Iterable
from typing import Final

DEPENDS: Final = re.compile(rb"\0depends=([^\0]*)\0")
"""Names of required modules in a module's section .modinfo, separated by commas."""


def module_name(file_name: str) -> str:
    """Return the kernel's name of a module: without .ko and what follows, and with underscores."""
    return file_name.partition(".ko")[0].replace("-", "_")


def dependencies(module: bytes) -> list[str]:
    """Return the modules that must be loaded before this one."""
    found = DEPENDS.search(module)
    return found[1].decode().replace("-", "_").split(",") if found and found[1] else []


def in_load_order(
    wanted: Iterable[str], content: Callable[[str], bytes | None]
) -> dict[str, bytes]:
    """Return modules by name, each after those that it depends on.

    Args:
        wanted: names, with hyphens or underscores.
        content: content of a module by name; None without a file, because the kernel has it built
            in.
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

"""Tries mutants of code that runs on import (constants, tables, defaults) in processes that import
it afresh.

The processes are forks of one that has imported only modules outside of this project. It has
bytecode of the rest in a folder that no other process uses.
"""

import contextlib
import importlib
import os
import sys
import tempfile
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TextIO

import pytest

from metro_tools.mutate.examples import few, same_always
from metro_tools.mutate.forks import Pool, result_of, write_line
from metro_tools.mutate.module_finder import install
from metro_tools.mutate.mutations import mutated
from metro_tools.mutate.task import PYTEST_ARGS, FreshImportTask, MutantOrder, MutantTask


class FreshImportPlugin:
    """A pytest plugin for tests in a separate process: it sets their order and reports the first
    failure.
    """

    def __init__(self, order: Sequence[str], told: TextIO) -> None:
        self._place = {name: at for at, name in enumerate(order)}
        self._told = told

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        same_always()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid in self._place]
        items.sort(key=lambda item: self._place[item.nodeid])
        few(items)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        tell_test(self._told, nodeid)


def tell_test(told: TextIO, name: str) -> None:
    """Report a test before it runs; the last reported one is the one that fails or never ends."""
    told.write(name + "\n")
    told.flush()


def last_told(text: str) -> str:
    return text.splitlines()[-1] if text else ""


def try_fresh(task: MutantTask, orders: FreshImportTask, report: TextIO) -> int:
    """Try each order in a fork of this process, which has imported nothing of the project."""

    def ended(name: tuple[str, int], code: int, text: str) -> None:
        result, by = result_of(code), last_told(text)
        survived = code == 0
        write_line(report, module=name[0], number=name[1], result=result, by="" if survived else by)

    with tempfile.TemporaryDirectory() as folder:
        sys.pycache_prefix = folder
        sys.dont_write_bytecode = False
        _import(orders.foreign)
        pool = Pool(task.jobs, ended)
        for order in orders.orders:
            pool.start(
                (order.module, order.number),
                lambda told, order=order: _run(task, order, folder, told),  # type: ignore[misc]
                order.limit_s,
            )
        pool.drain()
    return 0


def _run(task: MutantTask, order: MutantOrder, folder: str, told: TextIO) -> int:
    """Import the mutated module and run the tests; returns 0 when no test failed."""
    own = Path(folder) / f"{Path(order.module).stem}-{order.number}"
    own.mkdir()
    os.environ["PYTEST_DEBUG_TEMPROOT"] = str(own)
    path = Path(task.root) / order.module
    tree = mutated(path.read_text(encoding="utf-8"), order.number)
    install(order.module.removesuffix(".py").replace("/", "."), path, tree)
    files = dict.fromkeys(name.split("::")[0] for name in order.tests)
    return int(
        pytest.main(["-x", *PYTEST_ARGS, *files], plugins=[FreshImportPlugin(order.tests, told)])
    )


def _import(names: Iterable[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in names:
            # Some modules can be imported only after others have prepared them.
            with contextlib.suppress(Exception):
                importlib.import_module(name)

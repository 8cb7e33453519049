"""Serves the page of a server beside a test, in a thread."""

import asyncio
import threading
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Protocol


class PageServer(Protocol):
    """What the servers of live pages have in common."""

    @property
    def address(self) -> str: ...

    def run(self) -> Coroutine[Any, Any, None]: ...


@contextmanager
def served(server: PageServer) -> Iterator[str]:
    """Yield the address of the page while it is served."""
    runner = asyncio.Runner()
    loop = runner.get_loop()
    task = loop.create_task(server.run())

    def serve() -> None:
        with runner, suppress(asyncio.CancelledError):
            loop.run_until_complete(task)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield server.address
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()

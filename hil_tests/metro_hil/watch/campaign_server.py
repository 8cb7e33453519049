"""Serves the campaigns of a folder: list, history, comparison, and the page of each case."""

import json
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Lock
from typing import Final

from canlog.damage import LogError
from canlog.live.server import TokenServer
from canlog.reader import read
from canlog.views.page_data import page_data
from canlog.views.page_text import page_text
from canlog.views.serving import LOOPBACK, PAGE
from canlog.views.traces import default_words, trace_names
from metro_hil.engine.errors import EngineError
from metro_hil.engine.folder import CampaignFolder
from metro_hil.watch.bench_page import bench_page
from metro_hil.watch.campaigns import Shelf, cases_of

JSON: Final = "application/json"
REPORT: Final = "report.html"
PAGES_KEPT: Final = 4
"""Pages of cases that are kept in memory, some megabytes each."""

Query = Mapping[str, str]


class CampaignServer(TokenServer):
    """Read-only, like the live page: it writes no file and starts no campaign."""

    def __init__(
        self, root: Path, *, now_ns: Callable[[], int], host: str = LOOPBACK, port: int = 0
    ) -> None:
        """Listen. Raises LogError if the port is taken or not allowed.

        Args:
            now_ns: reads the wall clock, in nanoseconds since 1970.
        """
        super().__init__(host=host, port=port)
        self._shelf, self._now_ns = Shelf(root), now_ns
        self._turn = Lock()
        self._pages: OrderedDict[Path, bytes] = OrderedDict()
        self._paths: Mapping[str, Callable[[Query], tuple[str, bytes]]] = {
            "": lambda query: (PAGE, serve_page(root).encode()),
            "data": self._data,
            "cases": self._cases,
            "report": self._report,
            "case": self._case,
        }

    def answer(self, path: str, query: Query) -> tuple[str, bytes] | None:
        found = self._paths.get(path)
        if found is None:
            return None
        with self._turn:
            try:
                return found(query)
            except (EngineError, OSError) as error:
                raise LogError(str(error)) from error

    def _data(self, query: Query) -> tuple[str, bytes]:
        """Return all campaigns, or only the version if the viewer has that one already."""
        rows = self._shelf.look(self._now_ns())
        told: dict[str, object] = {"version": self._shelf.version}
        if query.get("seen") != str(self._shelf.version):
            told["campaigns"] = rows
        return JSON, _json(told)

    def _cases(self, query: Query) -> tuple[str, bytes]:
        return JSON, _json(cases_of(self._folder(query)))

    def _report(self, query: Query) -> tuple[str, bytes]:
        return PAGE, (self._folder(query).path / REPORT).read_bytes()

    def _case(self, query: Query) -> tuple[str, bytes]:
        folder, name = self._folder(query), query.get("id", "")
        if name not in {case.id for case in folder.cases()}:
            raise LogError(f"{name}: no case of this campaign")
        path = folder.kept(name).path
        if path not in self._pages:
            log = read(path)
            words = default_words(log) if trace_names(log) else []
            data = page_data(log, name, words, with_frames=True)
            self._pages[path] = page_text(data).encode()
        self._pages.move_to_end(path)
        while len(self._pages) > PAGES_KEPT:
            self._pages.popitem(last=False)
        return PAGE, self._pages[path]

    def _folder(self, query: Query) -> CampaignFolder:
        """Return the campaign that a request names; only those of the list exist."""
        name = query.get("path", "")
        found = self._shelf.folder(name)
        if found is None:
            raise LogError(f"{name}: no campaign of this folder")
        return found


def serve_page(root: Path) -> str:
    """Return the page of all campaigns; it fetches the data itself."""
    return bench_page("serve", title=json.dumps(str(root)).replace("<", "\\u003c"))


def _json(told: object) -> bytes:
    return json.dumps(told, ensure_ascii=False, separators=(",", ":")).encode()

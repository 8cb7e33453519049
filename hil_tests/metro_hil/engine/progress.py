"""Shows a running campaign: a bar with the time left, and failures as they come."""

from collections import Counter
from collections.abc import Sequence
from typing import Final, Protocol

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from firmware_py.clock.clock import NS_PER_S, WallClock
from metro_hil.model.case import Case, CaseResult, Verdict, mismatch

PLAIN_EVERY_S: Final = 10.0
"""Time between two progress lines where no terminal shows a bar, s."""
FAILURES_SHOWN_MAX: Final = 50
ESTIMATE_OVER_S: Final = 60.0
COLOURS: Final = {
    Verdict.PASS: "green",
    Verdict.FAIL: "bold red",
    Verdict.BLOCKED: "yellow",
    Verdict.INCONCLUSIVE: "yellow",
    Verdict.VACUOUS: "yellow",
    Verdict.INVALID: "magenta",
    Verdict.LOST: "bold magenta",
}


class Watcher(Protocol):
    """Receives the events of a running campaign."""

    def begin(self, cases: int, known: Sequence[CaseResult], what: str) -> None: ...
    def result(self, case: Case, result: CaseResult) -> None: ...
    def lost_attempt(self, case_id: str, attempt: int, reason: str) -> None: ...
    def say(self, words: str) -> None: ...
    def end(self) -> None: ...


class Silent:
    """A `Watcher` that shows nothing."""

    def begin(self, cases: int, known: Sequence[CaseResult], what: str) -> None: ...
    def result(self, case: Case, result: CaseResult) -> None: ...
    def lost_attempt(self, case_id: str, attempt: int, reason: str) -> None: ...
    def say(self, words: str) -> None: ...
    def end(self) -> None: ...


def margin_words(margin: float | None, unit: str, digits: int = 4) -> str:
    """The margin with sign and unit; the unit `1` is not written, and no margin gives no text."""
    if margin is None:
        return ""
    return f"{margin:+.{digits}g} {'' if unit == '1' else unit}".rstrip()


def failure_line(case: Case, result: CaseResult) -> str:
    """One line with verdict, case, the monitor with the least margin, and the reason."""
    words = [f"{result.verdict.value:>12}  {case.id}"]
    least = result.least_margin()
    if least is not None and least.margin is not None and result.verdict is Verdict.FAIL:
        words.append(f"[{least.name}: {margin_words(least.margin, least.unit, 3)}]")
    words.append(mismatch(case, result) or result.reason)
    return "  ".join(word for word in words if word)


class ProgressDisplay:
    """A `Watcher` that draws a bar on a terminal, or writes a line now and then to a file."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._counts: Counter[Verdict] = Counter()
        self._failures = 0
        self._progress: Progress | None = None
        self._clock = WallClock()
        self._cases = self._done = self._known = 0
        self._began_ns = self._said_ns = self._clock.now_ns()
        self._what = ""

    def begin(self, cases: int, known: Sequence[CaseResult], what: str) -> None:
        """Start the display.

        Args:
            cases: number of cases in all.
            known: results of an earlier session; they count as done, but not for the rate.
        """
        self._counts = Counter(result.verdict for result in known)
        self._cases, self._done, self._known = cases, len(known), len(known)
        self._began_ns = self._said_ns = self._clock.now_ns()
        self._what, self._failures = what, 0
        if self._console.is_terminal:
            self._progress = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}", style="cyan"),
                TextColumn("left"),
                TimeRemainingColumn(compact=True),
                TextColumn("{task.fields[counts]}"),
                console=self._console,
                refresh_per_second=4,
                speed_estimate_period=ESTIMATE_OVER_S,
            )
            self._progress.add_task(what, total=cases, completed=len(known), counts="", rate="")
            self._progress.start()

    def result(self, case: Case, result: CaseResult) -> None:
        self._done += 1
        self._counts[result.verdict] += 1
        if mismatch(case, result):
            self._failure(case, result)
        if self._progress is not None:
            speed = self._progress.tasks[0].speed
            self._progress.update(
                self._progress.task_ids[0],
                advance=1,
                counts=self._counts_markup(),
                rate="" if speed is None else f"{speed:.1f}/s",
            )
        elif self._clock.now_ns() - self._said_ns >= PLAIN_EVERY_S * NS_PER_S:
            self._plain()

    def _failure(self, case: Case, result: CaseResult) -> None:
        self._failures += 1
        if self._failures <= FAILURES_SHOWN_MAX:
            words = failure_line(case, result)
            self._console.print(words, style=COLOURS[result.verdict], markup=False, highlight=False)
        elif self._failures == FAILURES_SHOWN_MAX + 1:
            self.say("more failures are counted, not shown; `hil show` has them all")

    def lost_attempt(self, case_id: str, attempt: int, reason: str) -> None:
        self.say(f"tried again  {case_id}  attempt {attempt} was lost: {reason}")

    def say(self, words: str) -> None:
        self._console.print(words, markup=False, highlight=False, soft_wrap=True)

    def end(self) -> None:
        if self._progress is not None:
            self._progress.stop()
            self._progress = None
        else:
            self._plain()

    def _counts_markup(self) -> str:
        return "  ".join(
            f"[{COLOURS[verdict]}]{escape(verdict.value)} {self._counts[verdict]}[/]"
            for verdict in Verdict
            if self._counts[verdict]
        )

    def _plain(self) -> None:
        self._said_ns = self._clock.now_ns()
        counts = ", ".join(
            f"{verdict.value} {self._counts[verdict]}"
            for verdict in Verdict
            if self._counts[verdict]
        )
        self.say(f"{self._what}: {self._done} of {self._cases}{self._left()}; {counts or 'none'}")

    def _left(self) -> str:
        """Rate and time left as text; empty until the first new result."""
        new, since_s = self._done - self._known, (self._said_ns - self._began_ns) / NS_PER_S
        if new <= 0 or since_s <= 0.0:
            return ""
        rate_per_s = new / since_s
        left_s = (self._cases - self._done) / rate_per_s
        return f", {rate_per_s:.1f}/s, {left_s:.0f} s left" if left_s else f", {rate_per_s:.1f}/s"

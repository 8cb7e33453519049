"""Results of mutation testing, as tables and text. Pure."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from metro_tools.mutate.mutations import Mutant
from metro_tools.mutate.targets import EQUIVALENTS_FILE, Equivalent

KILLED: Final = "killed"
TIMED_OUT: Final = "timed out"
SURVIVED: Final = "survived"
UNREACHED: Final = "unreached"
NOT_NOTICED: Final = (SURVIVED, UNREACHED)
PERCENT: Final = 100.0
PAGE_FILE: Final = "docs/mutation.md"
TENTHS: Final = 10
PAGE_HEAD: Final = f"""# Mutation score

Written by `make mutate MUTATE_ARGS=--write`; [protection](design/protection.md#mutation) describes
the changes and how they are tried. A mutant is detected when a test fails or never ends.
`{EQUIVALENTS_FILE}` has an argument for each equivalent mutant why no test can detect it.
"""


@dataclass(frozen=True, slots=True)
class Tried:
    """One mutant and its result."""

    module: str
    mutant: Mutant
    result: str
    by: str
    """The first test that detected it."""


@dataclass(frozen=True, slots=True)
class Score:
    """The counts of one module, or of all."""

    mutants: int
    killed: int
    survived: int
    equivalent: int

    @property
    def percent(self) -> float:
        """Share of detected mutants, equivalent ones excluded."""
        wanted = self.mutants - self.equivalent
        return PERCENT * self.killed / wanted if wanted else PERCENT


def is_equivalent(tried: Tried, equivalents: Iterable[Equivalent]) -> bool:
    mutant = tried.mutant
    return any(
        (entry.module, entry.function, entry.mutation)
        == (tried.module, mutant.function, mutant.mutation)
        for entry in equivalents
    )


def survivors(tried: Iterable[Tried], equivalents: Sequence[Equivalent]) -> list[Tried]:
    """Return the mutants that a test must still detect."""
    return [
        item
        for item in tried
        if item.result in NOT_NOTICED and not is_equivalent(item, equivalents)
    ]


def stale(tried: Sequence[Tried], equivalents: Iterable[Equivalent]) -> Iterator[str]:
    """Yield the entries in the list of equivalents that are not valid any more; `tried` covers
    whole modules.
    """
    results = {(t.module, t.mutant.function, t.mutant.mutation): t for t in tried}
    modules = {item.module for item in tried}
    for entry in equivalents:
        if entry.module not in modules:
            continue
        found = results.get((entry.module, entry.function, entry.mutation))
        where = f"{EQUIVALENTS_FILE}: {entry.module}: {entry.function}: {entry.mutation}"
        if found is None:
            yield f"{where}: this mutant does not exist any more; remove the entry"
        elif found.result not in NOT_NOTICED:
            yield f"{where}: {found.by or 'a test'} detects it; remove the entry"


def scores(tried: Sequence[Tried], equivalents: Sequence[Equivalent]) -> dict[str, Score]:
    """Return the scores by module, in the order of the trials; the last is `all`."""
    counts: dict[str, Counter[str]] = {}
    for item in tried:
        of = "killed"
        if item.result in NOT_NOTICED:
            of = "equivalent" if is_equivalent(item, equivalents) else "survived"
        for name in (item.module, "all"):
            counts.setdefault(name, Counter())[of] += 1
    total = counts.pop("all", Counter())
    return {name: _score(count) for name, count in {**counts, "all": total}.items()}


def _score(count: Counter[str]) -> Score:
    return Score(count.total(), count["killed"], count["survived"], count["equivalent"])


def table(of: dict[str, Score]) -> str:
    """Format the scores, one line a module."""
    width = max(len(name) for name in of)
    head = f"{'module':<{width}}  mutants  killed  survived  equivalent   score"
    lines = [
        f"{name:<{width}}  {s.mutants:7}  {s.killed:6}  {s.survived:8}  {s.equivalent:10}"
        f"  {s.percent:5.1f} %"
        for name, s in of.items()
    ]
    return "\n".join((head, *lines))


def as_page(of: dict[str, Score]) -> str:
    """Format the scores as a page of the documentation."""
    total = of["all"]
    head = ("module", "mutants", "killed", "survived", "equivalent", "score")
    rows = [
        (f"`{name}`", *map(str, (s.mutants, s.killed, s.survived, s.equivalent)), _share(s))
        for name, s in of.items()
        if name != "all" and s.mutants
    ]
    sums = (total.mutants, total.killed, total.survived, total.equivalent)
    rows.append(("all", *map(str, sums), _share(total)))
    lines = [
        f"| {' | '.join(row)} |" for row in (head, ("---", *["---:"] * (len(head) - 1)), *rows)
    ]
    return f"{PAGE_HEAD}\n{score_line(total)}\n\n" + "\n".join(lines) + "\n"


def score_line(total: Score) -> str:
    """Return the line of the README, word for word."""
    wanted = total.mutants - total.equivalent
    return (
        f"**{total.killed} of {wanted} mutants are detected ({_share(total)}); "
        f"{total.equivalent} more are equivalent, each with its argument.**"
    )


def _share(score: Score) -> str:
    """Round down, so that only a full score gives 100 %."""
    return f"{int(score.percent * TENTHS) / TENTHS:.1f} %"


def as_difference(tried: Tried) -> str:
    """Describe a survivor: the change, its place, and how to try it again."""
    mutant = tried.mutant
    reach = "  (no test runs this function)" if tried.result == "unreached" else ""
    return (
        f"{tried.module}:{mutant.line}: {mutant.function}{reach}\n"
        f"  - {mutant.before}\n"
        f"  + {mutant.after}{f'   (number {mutant.occurrence})' if mutant.occurrence > 1 else ''}\n"
        f'  again: make mutate MUTATE_ARGS="{tried.module} --only {mutant.key}"'
    )

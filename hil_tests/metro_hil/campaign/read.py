"""Reads a campaign from a file, or from the same tables in Python; reports all errors at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_py import settings
from firmware_py.settings import SettingsError, nearest, unknown_key
from metro_hil.campaign.claims import check_claims, read_expected, read_vacuous
from metro_hil.campaign.definition import Body, PointMaker
from metro_hil.campaign.designs import Choice, design
from metro_hil.campaign.each import EACH, scenarios_of
from metro_hil.campaign.empty import empty_parts
from metro_hil.campaign.factors import CyclePhase, Factor, read_factors, where
from metro_hil.campaign.plan import Campaign, ScenarioPlan, SweepPoint
from metro_hil.campaign.problems import CampaignError, Findings, attempt
from metro_hil.campaign.sampled import FAULTS, FaultPool, draw, read_pool
from metro_hil.campaign.schema import (
    POOL,
    SEED_MAX,
    SEEDS_MAX,
    SWEEP,
    DesignKind,
    HeadKeys,
    SweepKeys,
)
from metro_hil.campaign.sources import Sources
from metro_hil.campaign.tables import (
    APPENDED,
    ConfigTable,
    KeyMissingError,
    merged,
    shaped,
)
from metro_hil.model.requirements import shipped_requirements

PACKAGE: Final = "metro_hil.campaign.shipped"
PROBLEM_POINTS_MAX: Final = 10
"""Number of wrong points after which reading stops, as an error of a sweep often affects all."""


@dataclass(frozen=True, slots=True)
class Definition:
    """A campaign with the tables and factors from which further points can be made."""

    campaign: Campaign
    bodies: tuple[Body, ...]
    factors: tuple[tuple[Factor, ...], ...]
    """Factors of each scenario, in the order of `bodies`."""


def read_campaign(name_or_path: str) -> Campaign:
    """Read a campaign by the stem of a shipped file or by path.

    Raises:
        CampaignError: with every problem of the file.
        SettingsError: if the file does not exist or is not TOML.
    """
    return read_definition(name_or_path).campaign


def read_definition(name_or_path: str) -> Definition:
    """Like `read_campaign`, but with the tables and factors."""
    path = settings.find(name_or_path, PACKAGE)
    text = settings.text_of(path)
    with settings.located(str(path), text):
        table = settings.tables_of(text, str(path))
        return define(table, source=str(path), folder=path.parent, name=path.stem)


def define(
    table: Mapping[str, Any], *, source: str, folder: Path = Path(), name: str = "campaign"
) -> Definition:
    """Read a campaign from the tables of one file.

    Args:
        source: name of the file in messages.
        folder: start of relative paths.
        name: name of the campaign unless the file has one.
    """
    return _Reader(source, Sources(folder)).read(table, name)


@dataclass(frozen=True, slots=True)
class KeyPlace:
    """Finds the place in the file of a scenario's key, which may be inherited."""

    above: ConfigTable
    own: ConfigTable
    index: int | None
    """Index of the `[[scenario]]`; None where the file is one scenario."""

    def key(self, key: str) -> str:
        if self.index is None:
            return key
        for name in APPENDED:
            if key.startswith(f"{name}["):
                number, _, rest = key.removeprefix(f"{name}[").partition("]")
                inherited = len(self.above.get(name, []))
                if int(number) < inherited:
                    return key
                return f"scenario[{self.index}].{name}[{int(number) - inherited}]{rest}"
        own, above = _depth(self.own, key), _depth(self.above, key)
        return key if above > own else f"scenario[{self.index}].{key}"


def _depth(table: Mapping[str, Any], key: str) -> int:
    """Number of parts of a dotted key that lead to a value in the table."""
    depth = 0
    inner: Any = table
    for name in key.replace('"', "").split("."):
        if not isinstance(inner, Mapping) or name not in inner:
            break
        inner = inner[name]
        depth += 1
    return depth


class _Reader:
    def __init__(self, source: str, sources: Sources) -> None:
        self._source = source
        self._sources = sources
        self._problems: list[str] = []
        self._notes: list[str] = []

    def read(self, table: Mapping[str, Any], name: str) -> Definition:
        findings = Findings()
        above = shaped(table, findings, inside_scenario=False)
        head = attempt(lambda t: settings.build(HeadKeys, t, ""), _head(above), "", findings)
        self._add_problems(findings, None)
        has_scenarios = "scenario" in above
        own_tables = scenarios_of(above, findings) if has_scenarios else [(None, "", None)]
        self._add_problems(findings, None)
        above.pop("scenario", None)
        if above.pop(EACH, None) is not None and not has_scenarios:
            self._add_problem(EACH, "needs a [[scenario]] to repeat for each value")
        campaign_name = above.pop("name", name)
        layout = above.pop("layout", None)
        made = [
            self._scenario(above, own, index, str(campaign_name)) for index, _, own in own_tables
        ]
        read = [scenario for scenario in made if scenario is not None]
        self._check_names([(index, own) for index, _, own in own_tables])
        if not own_tables:
            self._add_problem("scenario", "[] has no scenario")
        if self._problems:
            raise CampaignError(tuple(dict.fromkeys(self._problems)))
        assert head is not None
        plans, bodies, factors = zip(*read, strict=True)
        campaign = Campaign(
            name=campaign_name,
            title=head.title,
            description=head.description,
            layout=layout,
            scenarios=plans,
            files=dict(self._sources.files),
            notes=tuple(self._notes),
        )
        return Definition(campaign, bodies, factors)

    def _scenario(
        self, above: ConfigTable, own: Mapping[str, Any] | None, index: int | None, name: str
    ) -> tuple[ScenarioPlan, Body, tuple[Factor, ...]] | None:
        shape = Findings()
        kept = {} if own is None else shaped(own, shape, inside_scenario=True)
        place = KeyPlace(above, kept, index)
        self._add_problems(shape, f"scenario[{index}].")
        if own is not None and "name" not in kept and "name" not in own:
            self._add_problem(f"scenario[{index}].name", "missing key")
        table = merged(above, kept)
        table.setdefault("name", name)
        findings = Findings()
        head = attempt(lambda t: settings.build(HeadKeys, t, ""), _head(table), "", findings)
        seeds = read_seeds(table, findings)
        invariants = read_invariants(table, findings)
        body = Body(table, invariants, self._sources)
        sweep, factors, pool = _read_sweep(table.get("sweep", {}), findings)
        drawn = _drawn(sweep, seeds, table, findings)
        points = _points(body, sweep, factors, findings, pool=pool, seeds=seeds)
        expected, vacuous = read_expected(table, findings), read_vacuous(table, findings)
        if head is not None and not findings:
            check_claims(
                expected,
                vacuous,
                points,
                invariants=invariants,
                requirements=head.requirements,
                findings=findings,
            )
        for key, what in findings.found:
            self._add_problem(place.key(key), what)
        if head is None or sweep is None or findings:
            return None
        if sweep.new_seeds and not isinstance(table.get("seeds", 1), int):
            self._add_problem(
                place.key("sweep.new_seeds"), "needs seeds as a number, not as a list"
            )
        self._note(head.name, sweep, bool(factors))
        self._note_requirements(head.requirements)
        plan = ScenarioPlan(
            name=head.name,
            title=head.title,
            description=head.description,
            requirements=head.requirements,
            bench=head.bench,
            seeds=seeds[:1] if drawn else seeds,
            new_seeds=sweep.new_seeds or drawn,
            expected=expected,
            vacuous=vacuous,
            stop_at_violation=head.stop_at_violation,
            idle_counts=head.idle_counts,
            invariants=invariants,
            design=sweep.design.value if factors or drawn else None,
            levels={factor.key: in_words(factor) for factor in factors},
            points=points,
        )
        self._notes += empty_parts(plan, self._sources.paths)
        return plan, body, factors

    def _note(self, name: str, sweep: SweepKeys, swept: bool) -> None:
        count = sweep.count or 1
        if swept and sweep.design is DesignKind.SOBOL and count & (count - 1):
            power = 1 << count.bit_length()
            self._notes.append(
                f"{name}: sweep.count {count} is no power of two; a Sobol design is balanced for "
                f"{power // 2} or {power}"
            )

    def _note_requirements(self, names: Sequence[str]) -> None:
        """Note names that the shipped catalogue lacks; a project may have its own requirements."""
        known = list(shipped_requirements())
        for name in names:
            hint = nearest(name, known, "id")
            note = f"requirements: {name} is not in the catalogue"
            note += f"; {hint}" if hint.startswith("nearest") else ""
            if name not in known and note not in self._notes:
                self._notes.append(note)

    def _check_names(self, tables: Sequence[tuple[int | None, Mapping[str, Any] | None]]) -> None:
        """Report names that differ only in case: they name folders, and some systems ignore
        case."""
        names = [str((table or {}).get("name", "")).lower() for _, table in tables]
        for number, ((index, _), name) in enumerate(zip(tables, names, strict=True)):
            if name and names.index(name) != number:
                self._add_problem(f"scenario[{index}].name", f"{name!r} is used twice")

    def _add_problems(self, findings: Findings, prefix: str | None) -> None:
        for key, what in findings.found:
            self._add_problem(f"{prefix or ''}{key}", what)

    def _add_problem(self, key: str, what: str) -> None:
        self._problems.append(f"{self._source}: {key}: {what}")


def _head(table: Mapping[str, Any]) -> ConfigTable:
    return {name: table[name] for name in HeadKeys.__dataclass_fields__ if name in table}


def read_seeds(table: Mapping[str, Any], findings: Findings) -> tuple[int, ...]:
    """The seeds: a number of them from `seed_base` on, or a list."""
    seeds, base = table.get("seeds", 1), table.get("seed_base", 1)
    if isinstance(seeds, int) and not isinstance(seeds, bool):
        if not 1 <= seeds <= SEEDS_MAX:
            findings.add("seeds", f"{seeds} is not within 1..{SEEDS_MAX}")
            return ()
        return tuple(range(base, base + seeds)) if isinstance(base, int) else ()
    if not isinstance(seeds, list) or not seeds:
        findings.add("seeds", f"{seeds!r} is neither a whole number nor a list of them")
        return ()
    for seed in seeds:
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= SEED_MAX:
            findings.add("seeds", f"{seed!r} is not a whole number of 0 or more")
        elif seeds.count(seed) > 1:
            findings.add("seeds", f"{seed} is listed twice")
    return tuple(seeds)


def read_invariants(table: Mapping[str, Any], findings: Findings) -> str | tuple[str, ...]:
    """`all`, `none` or a list of names and numbers, which are checked with the monitors."""
    value = table.get("invariants", "all")
    if value in ("all", "none"):
        return str(value)
    if isinstance(value, list) and all(type(name) in (str, int) for name in value):
        return tuple(map(str, value))
    hint = f"; {nearest(value, ['all', 'none'])}" if isinstance(value, str) else ""
    findings.add("invariants", f"{value!r} is neither 'all', 'none' nor a list of names{hint}")
    return "all"


def _drawn(
    sweep: SweepKeys | None, seeds: Sequence[int], table: Mapping[str, Any], findings: Findings
) -> bool:
    """Whether the design is `drawn`, in which every seed makes its own point."""
    drawn = sweep is not None and sweep.design is DesignKind.DRAWN
    if drawn and len(seeds) > 1 and not isinstance(table.get("seeds", 1), int):
        findings.add("seeds", "with design 'drawn' must be a number, or a list of one seed")
    return drawn


def _read_sweep(
    table: Mapping[str, Any], findings: Findings
) -> tuple[SweepKeys | None, tuple[Factor, ...], FaultPool]:
    """The design, its factors and its pool of faults; without factors there is one point."""
    plain = {name: value for name, value in table.items() if name not in ("factors", *POOL)}
    for name in [name for name in plain if name not in SWEEP]:
        findings.add(f"sweep.{name}", unknown_key(name, list(SWEEP)))
        del plain[name]
    before = len(findings.found)
    factors = read_factors(table.get("factors", {}), findings)
    keys = attempt(lambda t: settings.build(SweepKeys, t, "", "sweep"), plain, "sweep", findings)
    pool = FaultPool()
    if keys is not None and keys.design is DesignKind.DRAWN:
        most = 1 if keys.faults_max is None else keys.faults_max
        tables, window = table.get("fault", []), table.get("window", {})
        least = keys.faults_min or 0
        if tables:
            pool = read_pool(tables, window, least=least, most=most, findings=findings)
    elif any(name in table for name in POOL):
        findings.add("sweep.fault", "is for design 'drawn' alone")
    if table and not factors and not pool.entries and len(findings.found) == before:
        findings.add("sweep.factors", "missing key; a sweep needs at least one factor")
    return (None if len(findings.found) > before else keys), factors, pool


def _points(
    body: Body,
    sweep: SweepKeys | None,
    factors: Sequence[Factor],
    findings: Findings,
    *,
    pool: FaultPool,
    seeds: Sequence[int],
) -> tuple[SweepPoint, ...]:
    """All points of the sweep, in order; their problems are reported."""
    keys = [factor.key for factor in factors]
    maker = PointMaker(body, [*keys, *([FAULTS] if pool.entries else [])], findings)
    choices = _choices(body, sweep, factors, findings, pool=pool, seeds=seeds)
    if choices is None:
        maker.report_body(findings)
        return ()
    points: list[SweepPoint] = []
    wrong = 0
    for number, choice in enumerate(choices):
        point = maker.point(number, choice, findings)
        if point is not None:
            points.append(point)
            continue
        wrong += 1
        if wrong == PROBLEM_POINTS_MAX:
            break
    return tuple(points)


def _choices(
    body: Body,
    sweep: SweepKeys | None,
    factors: Sequence[Factor],
    findings: Findings,
    *,
    pool: FaultPool,
    seeds: Sequence[int],
) -> list[Choice] | None:
    """The choices of the design; None if the sweep itself is wrong."""
    if not _keys_lead_somewhere(body, factors, findings) or sweep is None:
        return None
    if sweep.design is DesignKind.DRAWN:
        return [draw(seed, factors, pool) for seed in seeds]
    if not factors:
        return [{}]
    try:
        return design(sweep, factors)
    except SettingsError as error:
        findings.add_text(str(error), "sweep", ())
        return None


def _keys_lead_somewhere(body: Body, factors: Sequence[Factor], findings: Findings) -> bool:
    fine = True
    for factor in factors:
        try:
            body.with_values({factor.key: factor.at(0.0)})
        except KeyMissingError as error:
            findings.add(where(factor.key), error.args[0])
            fine = False
    return fine


def in_words(factor: Factor) -> str:
    """Text of the levels or the range; long lists are shortened."""
    if not factor.levels:
        assert factor.span is not None
        span = factor.span
        kind = "whole numbers " if span.integer else ""
        scale = "" if span.scale.value == "linear" else f", {span.scale.value} scale"
        return f"{kind}{span.low:g} to {span.high:g}{scale}"
    if isinstance(factor.levels[0], CyclePhase):
        base_s = factor.levels[0].base_s
        return f"{len(factor.levels)} offsets in the control cycle from {base_s:g} s on"
    shown = [str(level) for level in factor.levels]
    if len(shown) > 8:
        shown = [*shown[:4], "…", *shown[-2:]]
    return f"{', '.join(shown)} ({len(factor.levels)})"

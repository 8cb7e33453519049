"""Designs of a sweep: which points of its space are run."""

import itertools
import math
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

from firmware_py.expression import ExpressionError, compile_expression
from firmware_py.settings import SettingsError
from metro_hil.campaign.factors import Factor
from metro_hil.campaign.schema import POINTS_MAX, SAMPLED, DesignKind, SweepKeys

Choice = dict[str, Any]
"""Values by swept key."""
Refused = Callable[[Choice], bool]

COMBINATIONS_MAX = 200_000
"""Maximum number of combinations for which the greedy search can find a covering design."""
REDRAWS_MAX = 1000


def design(keys: SweepKeys, factors: Sequence[Factor]) -> list[Choice]:
    """The points of a sweep, which depend only on the arguments.

    Raises SettingsError, with a key below `sweep`, if the design is impossible.
    """
    refused = exclusion(keys.exclude, factors)
    if keys.design in SAMPLED:
        points = _sampled(keys, factors, refused)
    else:
        for factor in factors:
            if not factor.levels:
                raise SettingsError(
                    f'sweep.factors."{factor.key}": a range needs count or step with design '
                    f"{keys.design.value!r}"
                )
        if keys.design is DesignKind.FACTORIAL:
            points = factorial(factors, refused)
        else:
            points = covering(factors, keys.strength or 2, refused)
    if not points:
        raise SettingsError("sweep.exclude: leaves no point")
    return points


def factorial(factors: Sequence[Factor], refused: Refused) -> list[Choice]:
    """Every combination of all levels; the last factor changes fastest."""
    size = math.prod(len(factor.levels) for factor in factors)
    if size > POINTS_MAX:
        raise SettingsError(
            f"sweep.factors: {size} combinations, {POINTS_MAX} are possible; "
            f"design 'pairwise' or 'lhs' needs fewer"
        )
    keys = [factor.key for factor in factors]
    points = (
        dict(zip(keys, levels, strict=True))
        for levels in itertools.product(*(factor.levels for factor in factors))
    )
    return [point for point in points if not refused(point)]


def covering(factors: Sequence[Factor], strength: int, refused: Refused) -> list[Choice]:
    """Points in which every combination of levels of `strength` factors occurs.

    Combinations that `refused` excludes everywhere are not required. With no more factors than
    `strength`, the result holds every combination.
    """
    if strength >= len(factors):
        return factorial(factors, refused)
    sizes = [len(factor.levels) for factor in factors]
    wanted = sum(math.prod(some) for some in itertools.combinations(sizes, strength))
    if wanted > COMBINATIONS_MAX:
        raise SettingsError(
            f"sweep.strength: {wanted} combinations of {strength} levels, {COMBINATIONS_MAX} are "
            f"possible; take fewer factors, levels, or a lower strength"
        )
    import covertable

    names = [f"f{index}" for index in range(len(factors))]

    def allowed(row: dict[str, int]) -> bool:
        return not refused(_point(factors, [row[name] for name in names]))

    rows = covertable.make(
        {name: list(range(size)) for name, size in zip(names, sizes, strict=True)},
        strength=strength,
        constraints=[{"operator": "fn", "requires": names, "evaluate": allowed}],
    )
    return [_point(factors, [row[name] for name in names]) for row in rows]


def _point(factors: Sequence[Factor], choice: Sequence[int]) -> Choice:
    return {factor.key: factor.levels[level] for factor, level in zip(factors, choice, strict=True)}


def _sampled(keys: SweepKeys, factors: Sequence[Factor], refused: Refused) -> list[Choice]:
    assert keys.count is not None
    if keys.design is DesignKind.RANDOM:
        return _random(keys, factors, refused)
    shares = (
        latin_hypercube(keys.count, len(factors), keys.seed)
        if keys.design is DesignKind.LHS
        else sobol(keys.count, len(factors), keys.seed)
    )
    points = (_at(factors, share) for share in shares)
    return [point for point in points if not refused(point)]


def _random(keys: SweepKeys, factors: Sequence[Factor], refused: Refused) -> list[Choice]:
    """Sample the requested number of points; an excluded point is sampled again."""
    import numpy as np

    assert keys.count is not None
    generator = np.random.Generator(np.random.PCG64(keys.seed))
    points: list[Choice] = []
    in_vain = 0
    while len(points) < keys.count and in_vain < REDRAWS_MAX:
        point = _at(factors, generator.random(len(factors)).tolist())
        in_vain = in_vain + 1 if refused(point) else 0
        if not in_vain:
            points.append(point)
    if in_vain:
        raise SettingsError(f"sweep.exclude: refused {in_vain} random points one after another")
    return points


def _at(factors: Sequence[Factor], shares: Sequence[float]) -> Choice:
    return {factor.key: factor.at(share) for factor, share in zip(factors, shares, strict=True)}


def latin_hypercube(count: int, dimensions: int, seed: int) -> list[list[float]]:
    """Shares in [0, 1), shape (count, dimensions): each stratum of each axis occurs once."""
    import numpy as np
    from scipy.stats import qmc

    engine = qmc.LatinHypercube(dimensions, seed=np.random.default_rng(seed))
    drawn: list[list[float]] = engine.random(count).tolist()
    return drawn


def sobol(count: int, dimensions: int, seed: int) -> list[list[float]]:
    """Shares in [0, 1), shape (count, dimensions): the beginning of a scrambled Sobol sequence.

    Its balance is exact for powers of two; other counts take a part of the next larger one.
    """
    import numpy as np
    from scipy.stats import qmc

    engine = qmc.Sobol(dimensions, seed=np.random.default_rng(seed))
    drawn: list[list[float]] = engine.random_base2(max(0, (count - 1).bit_length())).tolist()
    return drawn[:count]


def exclusion(texts: Sequence[str], factors: Sequence[Factor]) -> Refused:
    """A function that says whether a sweep excludes a point.

    The expressions name numeric factors by key with `_` for each `.`, or by the last part of the
    key if it is unique. Raises SettingsError.
    """
    names = expression_names(factors)
    compiled = []
    for text in texts:
        try:
            compiled.append(compile_expression(text, list(names)))
        except ExpressionError as error:
            raise SettingsError(f"sweep.exclude: {error}") from None

    def refused(point: Choice) -> bool:
        values = SimpleNamespace(**{name: point[key] for name, key in names.items()})
        try:
            return any(expression(values) for expression in compiled)
        except ZeroDivisionError:
            words = ", ".join(f"{key} = {value!r}" for key, value in point.items())
            raise SettingsError(f"sweep.exclude: divides by zero with {words}") from None

    return refused


def expression_names(factors: Sequence[Factor]) -> dict[str, str]:
    """Swept keys by their names in expressions."""
    numeric = [factor.key for factor in factors if factor.numeric]
    lasts = [key.rpartition(".")[2] for key in numeric]
    short = {last: key for last, key in zip(lasts, numeric, strict=True) if lasts.count(last) == 1}
    full = {"".join(c if c.isalnum() else "_" for c in key): key for key in numeric}
    return {name: key for name, key in (short | full).items() if name.isidentifier()}

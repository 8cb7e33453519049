"""Few and deterministic examples for property tests, because many mutants meet them."""

from collections.abc import Iterable
from typing import Any, Final

import pytest
from hypothesis import HealthCheck, Phase, settings

PROFILE: Final = "mutate"
EXAMPLES: Final = 25
STEPS: Final = 20
_OF_FUNCTION: Final = "_hypothesis_internal_use_settings"


def same_always() -> None:
    """Disable randomness, the example database, and the shrinking of failing examples."""
    settings.register_profile(
        PROFILE,
        deadline=None,
        derandomize=True,
        database=None,
        max_examples=EXAMPLES,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.explicit, Phase.generate),
    )
    settings.load_profile(PROFILE)


def few(items: Iterable[pytest.Item]) -> None:
    """Limit the examples of tests that set a higher number themselves."""
    for item in items:
        function = getattr(item, "obj", None)
        function = getattr(function, "__func__", function)
        for holder, name in ((function, _OF_FUNCTION), (getattr(item, "cls", None), "settings")):
            asked = getattr(holder, name, None)
            if isinstance(asked, settings):
                setattr(holder, name, _less(asked))


def _less(asked: Any) -> settings:
    return settings(
        asked,
        max_examples=min(asked.max_examples, EXAMPLES),
        stateful_step_count=min(asked.stateful_step_count, STEPS),
    )

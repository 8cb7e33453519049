"""The bench of protection: that its figures are what they say; what a cycle costs is not judged."""

import pytest

from metro_hil import protection_bench
from metro_hil.worst_motion import LINE_END_M, limits, sections, worst_stop_m


def test_the_permitted_speed_is_not_lazy() -> None:
    (figure,) = protection_bench.laziness()

    assert figure.met
    assert figure.value.startswith("0.0"), figure.value


def test_distances_meet_their_bar_and_a_wrong_brake_rate_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(protection_bench, "LINES", 30)
    (right,) = protection_bench.error_of_distances()

    monkeypatch.setattr(
        protection_bench, "worst_stop_m", lambda *args, **more: 1.02 * worst_stop_m(*args, **more)
    )
    (wrong,) = protection_bench.error_of_distances()

    assert right.met
    assert not wrong.met


def test_lines_by_chance_keep_to_the_line() -> None:
    """Pieces that would leave it are left out, and limits cover it without a hole."""
    pieces = [(10.0, 3000.0, -5.0), (0.0, 2990.0, 7.0), (0.0, 1.0, 9.0)]

    assert sections(pieces) == ((10.0, 3010.0, -5.0), (3010.0, LINE_END_M, 7.0))
    assert limits(20.0, [(500.0, 10.0), (300.0, 15.0), (LINE_END_M, 1.0)]) == (
        (0.0, 300.0, 20.0),
        (300.0, 500.0, 15.0),
        (500.0, LINE_END_M, 10.0),
    )

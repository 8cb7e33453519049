"""A signal requests the end, and the former handlers are restored."""

import os
import signal

import pytest

from firmware_py.interrupts import Interrupts


@pytest.mark.parametrize(("number", "keyboard"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_a_signal_is_recorded_and_handlers_are_restored(number: int, keyboard: bool) -> None:
    before = signal.getsignal(number)
    interrupts = Interrupts()

    with interrupts.caught():
        os.kill(os.getpid(), number)
        asked = interrupts.asked

    assert asked
    assert interrupts.by_keyboard is keyboard
    assert signal.getsignal(number) is before


def test_handlers_are_restored_after_an_exception_too() -> None:
    before = signal.getsignal(signal.SIGTERM)

    with pytest.raises(RuntimeError), Interrupts().caught():
        raise RuntimeError

    assert signal.getsignal(signal.SIGTERM) is before

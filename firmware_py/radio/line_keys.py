"""Keys of a line's safety codes that follow their file, so that they change while programs run."""

import contextlib
import threading
from pathlib import Path
from typing import Final

from firmware_py.radio.credentials import ADVICE, Credentials
from firmware_py.settings import SettingsError
from zenoh_config.codec import BENCH_KEY, LineKeys, SafetyKey

LOOK_S: Final = 1.0
"""Period in which the file is looked at."""


def line_keys(secure: Credentials | None, look_s: float = LOOK_S) -> SafetyKey:
    """Return keys that follow their file until the program ends.

    Without credentials it is the public key of a bench. Raises SettingsError that names the file.
    """
    if secure is None:
        return BENCH_KEY
    try:
        keys = LineKeys(secure.line_keys)
    except ValueError as error:
        raise SettingsError(f"{secure.key_path}: {error}; {ADVICE}") from error
    if secure.key_path is not None:
        args = (keys, secure.key_path, look_s)
        threading.Thread(target=_follow, args=args, name="line keys", daemon=True).start()
    return keys


def _follow(keys: LineKeys, path: Path, look_s: float) -> None:
    """Take each change of the file. A file that cannot be read leaves the keys as they are."""
    taken, never = keys.text, threading.Event()
    while True:
        with contextlib.suppress(OSError, ValueError):
            text = path.read_text(encoding="utf-8")
            if text != taken:
                keys.take(text)
                taken = text
        never.wait(look_s)

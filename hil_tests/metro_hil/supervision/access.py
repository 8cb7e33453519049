"""Refuses to send commands or to start a line on an open network without certificates."""

import argparse

from firmware_py.settings import SettingsError
from zenoh_config.sessions import check_secured


def refuse_insecure(options: argparse.Namespace) -> None:
    """Raise SettingsError if other machines can reach a line that is not secured."""
    try:
        check_secured(
            options.line_radio, secured=options.secure is not None, insecure=options.insecure
        )
    except ValueError as error:
        raise SettingsError(f"--line-radio {error}") from error

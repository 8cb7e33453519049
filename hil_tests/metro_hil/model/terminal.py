"""Consoles of the commands."""

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from rich.console import Console

FILE_COLUMNS: Final = 160
"""Least width of tables in files and pipes. COLUMNS may ask for more."""


def console_for(*, json: bool = False, **options: Any) -> "Console":
    """Console on standard output, or with `--json` on standard error.

    A terminal gives its width. Files and pipes get wide lines, because a narrow table loses text.

    Args:
        options: further arguments of `rich.console.Console`.
    """
    from rich.console import Console

    console = Console(stderr=json, **options)
    if not console.is_terminal:
        console.width = max(console.width, FILE_COLUMNS)
    return console

"""What can be wrong with a campaign's folder, its journal or those who run its cases."""


class EngineError(Exception):
    """The host, the folder or the crew does not let the campaign go on (exit code 3)."""


class UsageError(Exception):
    """What the user asked for cannot be done (exit code 2); the text says what could."""

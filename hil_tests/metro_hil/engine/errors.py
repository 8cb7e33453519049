"""Errors of the engine: in a campaign's folder, its journal, its workers, or the user's request."""


class EngineError(Exception):
    """The host, the folder or the workers prevent the campaign from going on (exit code 3)."""


class UsageError(Exception):
    """The user's request cannot be carried out (exit code 2); the text says what is possible."""

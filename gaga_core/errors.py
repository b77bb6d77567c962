"""Errors that a user can fix."""


class GagaError(Exception):
    """One plain sentence for the user: what is wrong, where, and what to do.

    Raised for bad input (a truncated file, a missing column, a full disk), never for a wrong call:
    that is a ``ValueError`` with the argument's name. The window shows it as a notice, the command
    prints it and exits with status 1.
    """


class CancelledError(GagaError):
    """The user stopped a long task; everything is as it was before."""

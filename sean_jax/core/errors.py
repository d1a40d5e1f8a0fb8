"""Exceptions of the package: one hierarchy, whose messages are sentences that name the value and the cure."""


class SeanError(Exception):
    """Any refusal or failure of the package."""


class InputError(SeanError, ValueError):
    """The input cannot be used; the command line exits with code 2."""


class FileError(InputError):
    """A file cannot be used; the message has file, place, value and cure, one line for each error."""


class WriteError(InputError):
    """A path cannot be written: it holds something else, another process writes there, or the system refuses."""


class IncompleteError(SeanError, RuntimeError):
    """Work failed midway; the message says what is left and how to resume. The command line exits with code 1."""


class ControllerError(IncompleteError):
    """A controller outside of this program, or the way to it, has ended."""


class PartError(InputError):
    """A user's own function raises an error or has a wrong result; ``__cause__`` is its error."""

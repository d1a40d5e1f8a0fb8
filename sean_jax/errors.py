"""What the package raises: one hierarchy, whose messages are sentences that name the value and the cure."""


class SeanError(Exception):
    """Anything that the package refuses or could not finish."""


class InputError(SeanError, ValueError):
    """What was asked for cannot be done; the command line ends with code 2."""


class FileError(InputError):
    """A file cannot be used; the message names file, place, value and cure, one line an error."""


class WriteError(InputError):
    """A place cannot be written: it holds something else, another process writes there, or the system refuses."""


class IncompleteError(SeanError, RuntimeError):
    """Something broke midway; the message says what is left and how to go on. The command line ends with code 1."""


class PartError(InputError):
    """A function of a user's own raised something or gives a wrong value; ``__cause__`` is what it raised."""

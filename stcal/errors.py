"""One root for everything that stcal raises on purpose, each with the exit code it ends in.

Expected failures of the data (too few stars, no match) are returned values with a reason, not
exceptions.  What is raised here is broken input, broken configuration, or a refusal.
"""

from typing import Any


class StcalError(Exception):
    """Root of the package's own errors; ``document`` is what ``--json`` prints beside it."""

    exit_code = 1
    document: dict[str, Any] | None = None


class WorkerError(StcalError):
    """Work that was given to other processes or machines came to nothing."""


class UsageError(StcalError):
    """The command line asks for something that makes no sense."""

    exit_code = 2


class InputError(StcalError):
    """A file that the user named cannot be used; the message names file, row and reason."""

    exit_code = 3


class ConfigError(InputError):
    """A configuration file is wrong; the message lists every error at once."""


class GateRefusalError(StcalError):
    """A safety gate refused to let a result pass."""

    exit_code = 4

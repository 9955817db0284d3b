"""Records from a user's file."""

from pathlib import Path

from jaxreplay.errors import ConfigError
from jaxreplay.records import Records


def read(path: str | Path) -> Records:
    """Read the records in an `.npz` file that :meth:`jaxreplay.Records.save` wrote.

    Raises:
        ConfigError: there is no such file, or it does not contain records.
    """
    try:
        return Records.load(path)
    except (FileNotFoundError, ValueError) as error:
        raise ConfigError(str(error)) from None

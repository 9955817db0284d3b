"""The `.npz` file that :meth:`jaxreplay.Records.save` writes."""

from pathlib import Path

from jaxreplay.errors import ConfigError
from jaxreplay.recordings.formats.recording import Recording, Wanted, gather, select
from jaxreplay.records.file import stored


def read_npz(path: Path, wanted: Wanted) -> Recording:
    """Return the episodes in a file; a row's observation is made after its command.

    Raises:
        ConfigError: a name is unknown, or `episode` or `time` are given.
        ValueError: the file does not contain records.
    """
    if wanted.episode is not None or wanted.time is not None:
        raise ConfigError(f"{path}: it has no columns of episodes or times; leave them out")
    file = stored(path)
    observations = {name: [name] for name in file.sensor_names}
    actions = {name: [name] for name in file.command_names}
    selection = select(wanted, str(path), observations, actions, [*observations], [*actions])
    episodes = []
    for i, (sensors, commands) in enumerate(zip(file.sensors, file.commands, strict=True)):
        seen = dict(zip(file.sensor_names, sensors.T, strict=True))
        sent = dict(zip(file.command_names, commands.T, strict=True))
        where = f"{path}, record {i}"
        both = (sent | seen).__getitem__, (seen | sent).__getitem__
        episodes.append(gather(selection, where, *both, period=file.period))
    return Recording(selection, episodes, "after")

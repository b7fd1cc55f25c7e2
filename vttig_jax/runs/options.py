"""Options of one call of `vttig fit` as stored in `run.toml`: for reading logs, and for the fit."""

from typing import Any

import msgspec

from ..base.errors import UsageError
from ..identify.fit_settings import REMOVED, FitSettings, fields
from ..logs.recognition.request import ReadingOptions as ReadingOptions
from ..logs.recognition.request import roles_of

_OPTION = {field.name: field.option.split("/")[0] for field in fields()}


class RunOptions(msgspec.Struct, frozen=True):
    """Options of a fit in `run.toml`: how its logs are read, and the settings of the fit."""

    reading: ReadingOptions = ReadingOptions()
    settings: FitSettings = FitSettings()

    def check(self, logs: int, *, readings: bool) -> None:
        """Raise `UsageError` for options that exclude each other or do not apply.

        `logs` is the number of logs; `readings` is true if backlash readings are given.
        """
        roles_of(self.reading.columns)
        settings = self.settings
        if settings.use_readings and not readings:
            raise UsageError("--use-readings needs --backlash-readings FILE.")
        if settings.same_zero is not None and logs == 1:
            name = "--same-zero" if settings.same_zero else "--own-zero"
            raise UsageError(f"{name} compares several logs, but there is one; leave it out.")

    def table(self) -> dict[str, Any]:
        """Return the table `[options]` of `run.toml`, without the options that have no value."""
        merged = msgspec.to_builtins(self.reading) | msgspec.to_builtins(self.settings)
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in merged.items()
            if value is not None
        }


def options_from(table: dict[str, Any]) -> RunOptions:
    """Return the options in the table `[options]` of `run.toml`; missing options have defaults.

    **Raises** `msgspec.ValidationError` or `TypeError` for a damaged table, and `ValueError` for an
    option of an older version that has no counterpart.
    """
    if not isinstance(table, dict):
        raise TypeError("options")
    names = ReadingOptions.__struct_encode_fields__
    reading = {name: value for name, value in table.items() if name in names}
    settings = {name: value for name, value in table.items() if name not in names}
    for name, (default, instead) in REMOVED.items():
        usual = list(default) if isinstance(default, tuple) else default
        if name in settings and settings.pop(name) != usual:
            raise ValueError(f"`{name}` is no option any more: {instead}; take it out of run.toml")
    return RunOptions(
        msgspec.convert(reading, ReadingOptions), msgspec.convert(settings, FitSettings)
    )


def options_of(given: dict[str, Any]) -> RunOptions:
    """Return the options from the parameters of a command: name → value.

    **Raises** `UsageError` for two options that exclude each other.
    """
    names = ReadingOptions.__struct_fields__
    reading = ReadingOptions(**{name: given[name] for name in names if name in given})
    values = {name: value for name, value in given.items() if name not in names}
    try:
        return RunOptions(reading, FitSettings(**values))
    except ValueError as error:
        message = str(error).removeprefix("Arguments ").removeprefix("Argument ")
        for name, option in _OPTION.items():  # the names of Python arguments become options
            message = message.replace(f"`{name}`", option)
        raise UsageError(message) from None

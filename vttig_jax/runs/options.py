"""Options of one call of `vttig fit` as stored in `run.toml`: for reading logs, and for the fit."""

from typing import Any

import msgspec

from ..base.errors import UsageError
from ..identify.fit_settings import FitSettings, fields
from ..logs.recognition.request import ReadingOptions, roles_of


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

    **Raises** `msgspec.ValidationError` or `TypeError` for a damaged table.
    """
    if not isinstance(table, dict):
        raise TypeError("options")
    names = ReadingOptions.__struct_encode_fields__
    reading = {name: value for name, value in table.items() if name in names}
    settings = {name: value for name, value in table.items() if name not in names}
    return RunOptions(
        msgspec.convert(reading, ReadingOptions), msgspec.convert(settings, FitSettings)
    )


def settings_of(**values: Any) -> FitSettings:
    """Return the settings of a fit from the options of a command: name → value.

    **Raises** `UsageError` for two options that exclude each other.
    """
    try:
        return FitSettings(**values)
    except ValueError as error:
        message = str(error).removeprefix("Arguments ").removeprefix("Argument ")
        for field in fields():
            message = message.replace(f"`{field.name}`", field.option.split("/")[0])
        raise UsageError(message) from None

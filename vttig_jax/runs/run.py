"""Access to a run folder: its logs, fit, posterior, map, sweep, and the zeros of its encoders."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from ..base.errors import InputError, NoAnswerError, UsageError
from ..base.files.run_folder import data_sha256, write_files
from ..base.files.text_tables import key_values
from ..base.logger import LOGGER
from ..base.results import TextResult
from ..logs.readers.column_names import name_and_unit, units_of
from ..logs.recognition.request import SHAFTS, Statement
from ..pair.schema import as_fraction
from .run_file import CHECKPOINT, FIT_FILES, REPORT, SWEEP, RunRecord, read_run

if TYPE_CHECKING:
    from ..control.sweeps.table import SweepTable
    from ..identify.result import Fit
    from ..kinematics.backlash_map import BacklashMap
    from ..pair.gear_pair import Drive, GearPair, ShaftReading
    from ..posterior.summary.bands import BandedMap
    from ..posterior.summary.posterior import Posterior


@dataclass(frozen=True)
class Run(TextResult):
    """Run folder; each part of it is read at the first access to its property.

    **Arguments**
    - `folder`: the folder.

    If the folder does not hold a part, its property raises `UsageError` and names the command that
    makes the part. If the part is damaged, the property raises `InputError`.
    """

    folder: Path

    @cached_property
    def record(self) -> RunRecord:
        """Logs, digests, pair file and options of the fit: the content of `run.toml`."""
        return read_run(self.folder)

    @property
    def logs(self) -> dict[Path, str]:
        """Path of each log file → its SHA-256; "" for a log from arrays."""
        return dict(zip(self.record.logs, self.record.sha256, strict=True))

    @cached_property
    def pair(self) -> "GearPair | Drive":
        """The gear pair, or the drive."""
        from ..pair.gear_pair import pair_from_spec

        return pair_from_spec(self.record.spec)

    @cached_property
    def fit(self) -> "Fit":
        """The fit, together with its settings."""
        from ..identify.archive import read_fit
        from ..identify.result import FitRequest

        record, options = self.record, self.record.options
        paths = tuple(
            log.resolve() if digest else None
            for log, digest in zip(record.logs, record.sha256, strict=True)
        )
        reading = options.reading.keywords()
        request = FitRequest(options.settings, record.spec.fit, reading, paths)
        return replace(read_fit(self.folder, self.pair, run=record.digest), request=request)

    @cached_property
    def posterior(self) -> "Posterior":
        """The posterior, from the draws that `vttig sample` has written into the folder."""
        from ..posterior.sampler import read_posterior

        if not (self.folder / CHECKPOINT).exists():
            raise UsageError(
                f"there are no draws here; make them with `vttig sample {self.folder}`.",
                where=str(self.folder),
            )
        return read_posterior(self.folder / CHECKPOINT, self.fit)

    @cached_property
    def drawn(self) -> "Posterior | None":
        """The posterior, with a warning if its draws have not converged; None without draws."""
        if not (self.folder / CHECKPOINT).exists():
            return None
        if not self.posterior.diagnosis.converged:
            LOGGER.warning(
                "the draws have not converged, so that their intervals may be too narrow: %s",
                self.posterior.diagnosis,
            )
        return self.posterior

    @cached_property
    def map(self) -> "BacklashMap | BandedMap":
        """Backlash at every driving angle, with bands if the folder holds posterior draws."""
        if (self.folder / CHECKPOINT).exists():
            from ..posterior.summary.bands import band_map

            return band_map(self.posterior)
        from ..identify.backlash import backlash_map

        return backlash_map(self.fit)

    def write_beside(self, texts: Mapping[Path, str], *, overwrite: bool) -> None:
        """Write what was made of the run; the last file is what was asked for.

        **Raises** the errors of `refuse_own` and of `write_files`.
        """
        self.refuse_own(texts)
        write_files(texts, overwrite=overwrite)

    def refuse_own(self, paths: Iterable[Path]) -> None:
        """Raise `InputError` for a path that is a file of the run: its logs, its fit, its draws."""
        names = (*FIT_FILES, "pair.toml", CHECKPOINT, REPORT, SWEEP)
        own = {self.folder / name for name in names}
        own |= {*self.record.logs, *filter(None, [self.record.readings])}
        for path in paths:
            if path.resolve() in {one.resolve() for one in own}:
                raise InputError(
                    "is a file of the run itself, of which this is made; choose another name for"
                    " --out.",
                    where=str(path),
                )

    @cached_property
    def sweep(self) -> "SweepTable":
        """The sweep that `vttig sweep --out` wrote into the folder."""
        from .sweeps import read_sweep

        return read_sweep(self.folder)

    def __str__(self) -> str:
        parts = {"fit": "fit.json", "draws": CHECKPOINT, "map": "map.csv", "sweep": SWEEP}
        held = [name for name, file in parts.items() if (self.folder / file).exists()]
        rows = [("holds", ", ".join(held) or "nothing")]
        if (self.folder / "run.toml").exists():
            rows += [
                ("log", f"{log} ({digest[:12]})" if digest else f"{log.name}, from arrays")
                for log, digest in self.logs.items()
            ]
            changed = msgspec.structs.asdict(self.record.options.settings).items()
            default = msgspec.structs.asdict(type(self.record.options.settings)())
            asked = [f"{name} = {value}" for name, value in changed if value != default[name]]
            rows.append(("settings", ", ".join(asked) or "all as by default"))
        return key_values(rows, title=str(self.folder))


def open_run(folder: str | Path) -> Run:
    """Open a run folder that `vttig fit --out`, `Fit.save` or `vttig sweep --out` has written.

    **Arguments**
    - `folder`: the run folder.

    **Returns** a `Run`.

    **Raises** `UsageError` where the folder is missing or holds neither a fit nor a sweep.

    **Example**
    ```python
    >>> import tempfile
    >>> import vttig_jax
    >>> vttig_jax.enable_x64()
    >>> rig = vttig_jax.paper_rig()
    >>> result = vttig_jax.fit(rig.log(), rig.pair, delay="off")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result.save(folder, figures=False)
    ...     run = vttig_jax.open_run(folder)
    ...     run.fit.request.settings.delay, round(run.fit.value("driving_eccentricity_mm"), 3)
    ('off', 0.023)

    ```
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UsageError(
            "no such folder; make a run with `vttig fit LOG --pair PAIR --out DIR`.",
            where=str(folder),
        )
    if not any((folder / name).exists() for name in ("run.toml", SWEEP)):
        raise UsageError(
            "this folder holds neither run.toml nor a sweep; name a folder that `vttig fit --out`"
            " or `vttig sweep --out` has written.",
            where=str(folder),
        )
    return Run(folder)


def shaft_readings(run: RunRecord, fit: "Fit") -> "tuple[ShaftReading, ShaftReading]":
    """Return the conversions from readings of both encoders to the angles φ₁ and φ₂ of a fit.

    If the fit counts its angles from the encoder reading zero, the angle is the reading times a
    sign and a scale. If it counts from the first sample of the log, the reading of that sample is
    subtracted first.

    **Raises** `NoAnswerError` for a log with a transmission error in place of the driven channel,
    and `InputError` if the unit of the first reading is unknown.
    """
    from ..pair.gear_pair import shaft_reading

    if fit.zero_readings["driven"] is None:
        raise NoAnswerError(
            "its log holds a transmission error in place of the driven channel, so that no reading"
            " of a driven encoder belongs to this fit; fit a log of both encoders.",
            where=fit.source,
        )
    statement = Statement.of(run.spec, run.options.reading)
    found = []
    for shaft, encoder in zip(SHAFTS, statement.encoders, strict=True):
        scale = as_fraction(getattr(run.spec.log, f"{shaft}_scale"), f"log.{shaft}_scale")
        first, zero = fit.zero_readings[shaft], 0.0
        if fit.zero != "reading" and first:
            radians = statement.radians(shaft, _unit(run, fit, statement, shaft))
            assert radians is not None  # ensured by the reader of the log
            zero = first * radians
        found.append(shaft_reading(encoder, zero, scale.numerator / scale.denominator))
    driving, driven = found
    return driving, driven


def _unit(run: RunRecord, fit: "Fit", statement: Statement, shaft: str) -> str:
    """Return the unit of the reading of `shaft` in the first sample.

    It is "counts" if the reading is an integer. Otherwise it comes from the column name, the pair
    file or the log, in this order.
    """
    if isinstance(fit.zero_readings[shaft], int):
        return "counts"
    name = getattr(statement.layout, shaft)
    written = name_and_unit(name, units_of(shaft), str(name))[1] if name else None
    if unit := written or getattr(statement.unit, shaft):
        return unit
    from ..logs.read import read_log

    log = run.logs[0]
    if not log.is_file() or data_sha256(log) != run.sha256[0]:
        raise InputError(
            f"the angles of this fit count from the first sample, where the {shaft} encoder read"
            f" {fit.zero_readings[shaft]:g}, but in which unit only the log says, and that is gone"
            f" or has changed; put it back, or name the column with its unit in [log] of the pair"
            " file and fit again.",
            where=str(log),
        )
    return getattr(read_log(log, run.spec, **run.options.reading.keywords()), shaft).unit

"""`vttig inspect`: what a log holds and what is wrong with it. Needs no jax."""

from pathlib import Path

import click

from ..options import log_options, roles_of, verb
from ..output import Output


@verb(
    "inspect",
    compiles=False,
    example="vttig inspect log.csv --pair pair.toml\n"
    "vttig inspect log.csv --column time=t_s --column driving=motor_deg",
)
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--pair",
    type=click.Path(path_type=Path),
    help="TOML of the pair or drive; without it only what the columns show by themselves.",
)
@log_options
def command(
    output: Output,
    log: Path,
    pair: Path | None,
    columns: tuple[str, ...],
    decimal: str | None,
    sample_rate: float | None,
) -> None:
    """Say what LOG holds: columns, rate, turns, ratio, flanks, speeds and orders."""
    from ...logs.inspection import inspect_log
    from ...logs.preview import preview_log
    from ...logs.read import read_log
    from ...pair.pair_file import load_pair_spec

    named = roles_of(columns)
    if pair is None:
        report = preview_log(log, columns=named, decimal=decimal, sample_rate_hz=sample_rate)
    else:
        spec = load_pair_spec(pair)
        read = read_log(log, spec, columns=named, decimal=decimal, sample_rate_hz=sample_rate)
        report = inspect_log(read, spec)
    output.emit(report.to_json(), report)

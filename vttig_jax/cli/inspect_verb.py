"""`vttig inspect`: what a log holds and what is wrong with it. Needs no jax."""

from pathlib import Path

import click

from ..logs.columns import ROLES
from .options import POSITIVE, verb
from .output import Output


@verb(
    "inspect",
    example="vttig inspect log.csv --pair pair.toml\n"
    "vttig inspect log.csv --column time=t_s --column driving=motor_deg",
)
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--pair",
    type=click.Path(path_type=Path),
    help="TOML of the pair or drive; without it only what the columns show by themselves.",
)
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="ROLE=NAME",
    help=f"Name the column of a role ({', '.join(ROLES)}); may be repeated.",
)
@click.option("--decimal", type=click.Choice([".", ","]), help="Decimal mark of the log.")
@click.option(
    "--sample-rate",
    type=POSITIVE,
    metavar="HZ",
    help="Samples per second of a log without a time column.",
)
def command(
    output: Output,
    log: Path,
    pair: Path | None,
    columns: tuple[str, ...],
    decimal: str | None,
    sample_rate: float | None,
) -> None:
    """Say what LOG holds: columns, rate, turns, ratio, flanks, speeds and orders."""
    from ..logs.inspection import inspect_log
    from ..logs.preview import preview_log
    from ..logs.read import read_log
    from ..pair.spec import load_pair_spec

    named = _roles(columns)
    if pair is None:
        report = preview_log(log, columns=named, decimal=decimal, sample_rate_hz=sample_rate)
    else:
        spec = load_pair_spec(pair)
        read = read_log(log, spec, columns=named, decimal=decimal, sample_rate_hz=sample_rate)
        report = inspect_log(read, spec)
    output.emit(report.to_json(), report)


def _roles(columns: tuple[str, ...]) -> dict[str, str]:
    """`role=name` options as a mapping."""
    named: dict[str, str] = {}
    for option in columns:
        role, equals, name = option.partition("=")
        if not equals or not name or role not in ROLES:
            raise click.BadParameter(
                f"{option!r} must be ROLE=NAME with a role of {', '.join(ROLES)}.",
                param_hint="--column",
            )
        if role in named:
            raise click.BadParameter(f"`{role}` is named twice.", param_hint="--column")
        named[role] = name
    return named

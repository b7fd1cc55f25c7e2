"""`vttig plan`: predict the standard errors of a planned run before anything is measured."""

from typing import Annotated, Literal

import click

from ...base.errors import UsageError
from ..drive_options import PairFile, Ratio
from ..fit_options import time_type
from ..options import Finite, NotNegative, Positive, arguments_as_options, key_value, once, verb
from ..output import Output

DirectionName = Literal["both", "forward", "backward"]
NAMED = key_value("name=number", lambda _, number: Finite().convert(number, None, None))


@verb(
    "plan",
    example="""
vttig plan --ratio 64:23 --turns 21 --rate-hz 2000 --noise-std-deg 0.002
vttig plan --pair pair.toml --turns 21 --rate-hz 1987 --noise-std-deg 0.002
vttig plan --pair pair.toml --turns 21 --noise-std-deg 0.002 --speed-rpm 20 --speed-rpm 60
vttig plan --pair pair.toml --noise-std-deg 0.002 --want driving_eccentricity_mm=0.0001
""",
    groups={
        "The drive": ("ratio", "teeth", "counts", "pair"),
        "The run": ("turns", "speeds_rpm", "directions", "passes", "rate_hz", "dwell_s", "ramp_s"),
        "The noise": ("noise_std_deg", "noise_correlation_s", "white_std_deg"),
        "The fit": ("want", "assume", "perfect_encoders", "delay"),
    },
)
def command(
    output: Output,
    *,
    pair: PairFile,
    drive: Ratio,
    turns: Annotated[
        Positive | None,
        "Of the driving shaft in every pass, ramps included; with --want the most to be spent,"
        " 1000 by default.",
    ],
    speeds_rpm: Annotated[
        tuple[Positive, ...],
        "--speed-rpm",
        "Of the driving shaft, 60 by default; repeat it for passes at several speeds in one"
        " recording, which tell a delay.",
    ],
    directions: Annotated[DirectionName, "Of the passes."] = "both",
    passes: Annotated[int | None, click.IntRange(min=1), "At every speed; 2 for both directions."],
    rate_hz: Annotated[Positive | None, "Of sampling; that of the pair file by default."],
    dwell_s: Annotated[NotNegative, "Standstill after every pass."] = 2.0,
    ramp_s: Annotated[NotNegative, "From standstill to speed."] = 0.5,
    noise_std_deg: Annotated[
        float,
        Finite(min=0, max=360),
        "Noise of one sample of the transmission error, as `vttig fit -v` prints it for a log;"
        " counting is added from the pair.",
    ],
    noise_correlation_s: Annotated[NotNegative, "Its memory."] = 0.0,
    white_std_deg: Annotated[NotNegative, "White noise beside it."] = 0.0,
    assume: Annotated[
        tuple[tuple[str, float], ...],
        NAMED,
        "Amplitude or phase to expect, such as driving_eccentricity_mm=0.03; decides what a phase"
        " costs.",
    ],
    perfect_encoders: Annotated[bool, "Fit no encoder eccentricity."],
    delay: Annotated[
        str | float,
        time_type("delay", "s", ("auto", "off")),
        {"metavar": "auto|off|SECONDS"},
        "As in `vttig fit`: fitted (auto, the default), taken as zero, or known in seconds.",
    ] = "auto",
    want: Annotated[
        tuple[tuple[str, float], ...],
        NAMED,
        "Standard error to reach, such as driving_eccentricity_mm=0.0001; repeatable. Finds the"
        " fewest turns.",
    ],
) -> None:
    """Say how well a fit of a run would know every parameter, before the run is made.

    The standard errors follow from the motion, the sampling and the noise that are assumed, by the
    model of `vttig fit`. With --want the shortest run is looked for.
    """
    from ...pair.gear_pair import pair_from_spec
    from ...posterior.planning.noise import PlannedNoise
    from ...posterior.planning.plan import MOST_TURNS, plan, shortest_run
    from ...runs.stated_drive import spec_of_file

    rig = pair_from_spec(spec_of_file(pair, drive))
    rate_hz = rate_hz or rig.log.sample_rate_hz
    if rate_hz is None:
        unless = "" if pair is None else ", and the pair file has no sample_rate_hz"
        raise UsageError(f"--rate-hz is missing{unless}.")
    if turns is None and not want:
        raise UsageError("--turns is missing; give it, or what to reach with --want.")
    wanted = once("--want", want)
    if noise_correlation_s and not noise_std_deg:
        raise UsageError(
            "--noise-correlation-s is the memory of --noise-std-deg, which is 0; give it a size."
        )
    keywords = {
        "rate_hz": rate_hz,
        "speed_rpm": speeds_rpm or (60.0,),
        "noise": PlannedNoise(noise_std_deg, noise_correlation_s, white_std_deg),
        "assumed": once("--assume", assume),
        "directions": directions,
        "passes": passes,
        "dwell_s": dwell_s,
        "ramp_s": ramp_s,
        "perfect_encoders": perfect_encoders,
        "delay": delay,
    }
    names = {"target": "--want", "assumed": "--assume", "noise": "--noise-std-deg"}
    with arguments_as_options(names):
        if wanted or turns is None:  # one of both is given
            found = shortest_run(rig, wanted, most_turns=turns or MOST_TURNS, **keywords)
        else:
            found = plan(rig, turns=turns, **keywords)
    output.emit(found.to_json(), found)

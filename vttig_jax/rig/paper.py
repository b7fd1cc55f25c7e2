"""Rig of the paper: Tables 1 and 2, and the run of its Fig. 11a."""

import numpy as np

from ..kinematics.backlash_map import BacklashMap
from ..pair.gear_pair import Eccentricities, Gear, GearPair
from ..pair.schema import Encoder
from .imperfections import EncoderError, Noise, random_orders
from .motion import PassMotion
from .synthetic import SyntheticRig

ERN180 = Encoder(counts_per_rev=90_000, accuracy_arcsec=18.0)
"""Encoder with 3600 lines and 25-fold interpolation."""


def paper_pair() -> GearPair:
    """Return the gear pair of Table 1 of the paper, with the encoders of its test rig."""
    return GearPair(
        Gear(45, 3.0, 3.0, 20.0, ERN180),
        Gear(80, 3.0, 3.0, 20.0, ERN180),
        module_mm=2.0,
        pressure_angles_deg=20.0,
        centre_distance_mm=125.12,
        name="VTTIG rig of the paper",
    )


def paper_eccentricities() -> Eccentricities:
    """Return the eccentricities of Table 2 of the paper and a constant backlash of 0.038°.

    0.038° is the paper's jump of 0.0443° at 7560° minus the variable backlash j_v at this angle.
    """
    return Eccentricities(
        driving_mm=0.0226,
        driving_phase_deg=49.5,
        driven_mm=0.0273,
        driven_phase_deg=79.3,
        constant_backlash_deg=0.038,
    )


def paper_rig(seed: int = 0, motion: PassMotion = PassMotion()) -> SyntheticRig:
    """Return the paper's rig with plausible imperfections; its raw logs were never published.

    The run goes to 7560° and back at 60 rpm with 0.1 % speed ripple. The imperfections are noise of
    0.002° with a correlation time of 4.75 ms, a tooth-mesh order of 0.003°, pitch orders 2–8 of
    0.002° rms and 18″ of encoder eccentricity on both shafts. `seed` draws the orders and encoder
    phases (`SyntheticRig.log` has the noise seed); draws that would close the gap are repeated.
    """
    generator = np.random.default_rng(seed)
    phases = generator.uniform(0, 360, 2)
    while True:
        rig = SyntheticRig(
            pair=paper_pair(),
            eccentricities=paper_eccentricities(),
            motion=motion,
            orders=random_orders(generator, pitch_rms_deg=0.002, mesh_amplitude_deg=0.003),
            driving_encoder=EncoderError(18.0, float(phases[0])),
            driven_encoder=EncoderError(18.0, float(phases[1])),
            noise=Noise(0.002, 0.00475),
        )
        if BacklashMap(rig.flank_model(), None, rig.pair).smallest.backlash > 0:
            return rig

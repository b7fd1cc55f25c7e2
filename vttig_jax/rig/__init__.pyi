from .imperfections import EncoderError as EncoderError
from .motion import PassMotion as PassMotion
from .paper import paper_eccentricities as paper_eccentricities
from .paper import paper_pair as paper_pair
from .paper import paper_rig as paper_rig
from .synthetic import SyntheticRig as SyntheticRig
from .synthetic import fixed_gear_readings as fixed_gear_readings

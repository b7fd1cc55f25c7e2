from .fit_run import save_fit as save_fit
from .fit_run import save_posterior as save_posterior
from .paper_runs import simulate_paper as simulate_paper
from .run import Run as Run
from .run import open_run as open_run
from .simulations import simulate as simulate
from .simulations import sweep as sweep
from .simulations import tune as tune

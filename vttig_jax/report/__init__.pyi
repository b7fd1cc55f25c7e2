from .comparison import Comparison as Comparison
from .comparison import compare_runs as compare_runs
from .page import Report as Report
from .page import require_bokeh as require_bokeh
from .page import write_report as write_report

"""Planning and executing the work on a collection; nothing else knows executors."""

from lfflow.run.batch import make_plan, run_collection, scan_collection
from lfflow.run.options import Options, Outcome

__all__ = ["Options", "Outcome", "make_plan", "run_collection", "scan_collection"]

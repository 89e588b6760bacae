"""Planning and executing the work on a collection; nothing else knows executors."""

from lfflow.run.batch import Options, Outcome, make_plan, run_collection, scan_collection

__all__ = ["Options", "Outcome", "make_plan", "run_collection", "scan_collection"]

"""Measured against simulated: where they disagree, which effect is missing, and the model with it added."""

from radiometer.reconcile.engine import Reconciled, gap_of, gaps_of, reconcile, reconcile_capture
from radiometer.reconcile.report.result import FittedParameter, FoundEffect, ReconcileResult, Verdict

__all__ = [
    "FittedParameter",
    "FoundEffect",
    "ReconcileResult",
    "Reconciled",
    "Verdict",
    "gap_of",
    "gaps_of",
    "reconcile",
    "reconcile_capture",
]

"""Measured against simulated: where they disagree, which effect is missing, and the model with it added."""

from radiometer.reconciliation.engine import reconcile_capture
from radiometer.reconciliation.result import FittedParameter, FoundEffect, ReconcileResult, Verdict
from radiometer.reconciliation.search import Reconciled

__all__ = ["FittedParameter", "FoundEffect", "ReconcileResult", "Reconciled", "Verdict", "reconcile_capture"]

"""The radiance of one patch: which frames may be used, the estimate, its uncertainty and flags."""

"""Figures of another program on the reference measurements of EMVA 1288.

Source: package `emva1288` 1.0.2 on the descriptor of the set `ref001` (a 12-bit CCD by Basler) of EMVA1288/datasets, as
the provenance note next to these data gives them: DN/e⁻, %, DN per photon, e⁻, photons, dB, e⁻/s.
"""

REF001 = {
    "K": 0.28035,
    "eta": 45.22,
    "R": 0.126778,
    "sigma_d": 10.913,
    "mu_e_sat": 13_999.0,
    "mu_p_sat": 30_957.0,
    "SNR_max": 118.3,
    "DR_dB": 61.74,
    "LE_min": -0.605,
    "LE_max": 0.455,
    "mu_I_mean": 29.2,
    "PRNU_1288": 0.430,
}
# What few frames hardly determine.
REF001_LOOSE = {"DSNU_1288": 0.240, "mu_I_var": 81.0}

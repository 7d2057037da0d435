"""Worked examples of the Guide.

Source: JCGM 100:2008, H.1 (end-gauge), H.2 (impedance), H.3 (thermometer), table G.2; JCGM 101:2008, 9.2 (additive
model). Of H.2 the impedance V/I alone: resistance and reactance are functions of three inputs that nothing here has.
"""

# H.1: standard uncertainty in nm and degrees of freedom of each contribution; what the Guide concludes.
END_GAUGE = ((25.0, 18.0), (9.7, 25.6), (2.9, 50.0), (16.6, 2.0))
END_GAUGE_U_NM, END_GAUGE_FREEDOM, END_GAUGE_K99, END_GAUGE_U99_NM = 32.0, 16.0, 2.92, 93.0
# H.1.3.2: the comparator's parts in nm with their degrees of freedom, which make the second contribution above.
COMPARATOR = ((5.8, 24.0), (3.9, 5.0), (6.7, 8.0))
# H.1.3.4 and H.1.4: length in nm, expansion in 1/K, temperatures in K, which make the third and the fourth.
GAUGE_NM, EXPANSION_PER_K = 50.000623e6, 11.5e-6
U_EXPANSION_PER_K, DEVIATION_K, U_DIFFERENCE_K = 1e-6 / 3**0.5, 0.1, 0.05 / 3**0.5

# H.2: five simultaneous observations, V in V and I in mA; mean impedance in Ω with its standard uncertainty.
VOLTAGE, CURRENT_MA = (5.007, 4.994, 5.005, 4.990, 4.999), (19.663, 19.639, 19.640, 19.685, 19.678)
VOLTAGE_U, CURRENT_U_MA, CORRELATION = 0.0032, 0.0095, -0.36
IMPEDANCE, IMPEDANCE_U = 254.260, 0.236

# H.3: readings t in °C less 20 °C, and corrections b in °C; intercept, slope, their uncertainties, scatter.
THERMOMETER = (
    (1.521, -0.171), (2.012, -0.169), (2.512, -0.166), (3.003, -0.159), (3.507, -0.164), (3.999, -0.165),
    (4.513, -0.156), (5.002, -0.157), (5.503, -0.159), (6.010, -0.161), (6.511, -0.160),
)  # fmt: skip
THERMOMETER_INTERCEPT, THERMOMETER_SLOPE = (-0.1712, 0.0029), (0.00218, 0.00067)
THERMOMETER_SCATTER = 0.0035

# Table G.2: degrees of freedom, t for 68.27, 95.45 and 99.73 %.
STUDENT = (
    (1, 1.84, 13.97, 235.80), (2, 1.32, 4.53, 19.21), (3, 1.20, 3.31, 9.22), (4, 1.14, 2.87, 6.62),
    (5, 1.11, 2.65, 5.51), (10, 1.05, 2.28, 3.96), (20, 1.03, 2.13, 3.42),
    (50, 1.01, 2.05, 3.16), (100, 1.005, 2.025, 3.077),
)  # fmt: skip

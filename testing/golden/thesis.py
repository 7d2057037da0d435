"""Numbers of the source thesis.

Source: the thesis's tables 3.1 and 3.2 and section 3.1 (its equations 2.6, 2.9 to 2.12), digits as printed there.
"""

# Luminance in cd·m⁻², f-number, exposure in s, K in cd·m⁻²·s; all at the speed that was measured.
METER_CONSTANTS = (
    (250.0, 16, 1 / 8, 16.6016), (250.0, 5.6, 1 / 60, 18.0697), (250.0, 1.7, 1 / 640, 18.3824),
    (350.0, 16, 1 / 13, 14.3029), (350.0, 5.6, 1 / 100, 15.1786), (350.0, 1.7, 1 / 1000, 16.4706),
)  # fmt: skip
MEASURED_ISO = 136.0
MEAN_METER_CONSTANT = 16.5
# The photograph at f/16, 1/125 s: luminance in cd·m⁻², equation (2.10) in W·sr⁻¹·m⁻²·µm⁻¹, exposure in J·m⁻², its log.
REFERENCE_LUMINANCE, REFERENCE_SPECTRAL_RADIANCE = 3882.3529, 53.2234
REFERENCE_EXPOSURE_J_M2, REFERENCE_LOG_EXPOSURE = 1.30624e-3, -6.6406

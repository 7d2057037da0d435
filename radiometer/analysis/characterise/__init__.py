"""Characterisation of a camera after EMVA 1288: gain, noise, dark current, saturation, linearity, non-uniformity.

subject = read_subject(Path("capture"))     # or an EMVA 1288 descriptor file
result = characterise(subject)
result.figures["K"]                         # Quantity(value, u, "DN/e-")
result.to_mapping()                         # the camera file
"""

from radiometer.analysis.characterise.characterise import characterise
from radiometer.analysis.characterise.result import Characterisation
from radiometer.analysis.characterise.subject import Subject, read_subject, subject_of_capture

__all__ = [
    "Characterisation",
    "Subject",
    "characterise",
    "read_subject",
    "subject_of_capture",
]

"""The instrument in other people's laboratories: Bluesky plans and PsychoPy's calibration.

Each module needs the package that it is named after, and is imported by who has it: nothing here is loaded by the rest.
"""

"""The instrument: frames in, radiance with an uncertainty out."""

__version__ = "0.1.0"

"""Meaning of digital numbers: signal, noise, dark level, lens, and the spectra that turn a signal into light."""

"""What digital numbers mean: signal, noise, dark level, lens, and the spectra that turn a signal into light."""

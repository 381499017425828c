"""Default parameters of radio and sound signals, for filters and simulated recordings."""

POWER_DBM = -60.0
"""Strength of a tag's signal at a distance of 1 m [dBm]."""
EXPONENT = 2.0
"""Exponent of the path loss: that of free space."""
NOISE_DB = 5.0
"""Standard deviation of the white noise of a read [dB]."""
SHADOW_DB = 3.0
"""Standard deviation of the shadowing [dB]."""
SHADOW_S = 5.0
"""Time in which shadowing is forgotten [s]."""
NLOS_BIAS_SIGMAS = 10.0
"""Mean length of a detour of a signal, in standard deviations of the range."""

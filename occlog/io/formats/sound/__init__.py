"""WAV files and logs of directions of arrival."""
